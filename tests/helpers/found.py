"""Bad dumps that an attack found: once they crashed, hung, took memory, or failed long after they were read.

As in malformed.py: what is done to a good file of 24 states.
"""

import io

import h5py
import numpy as np
from PIL import Image
from spoil import attribute, instead

from dirl.scenes.io.digest import write_digest
from dirl.scenes.views import encode

VIEW = encode(np.arange(12 * 16 * 3, dtype=np.uint8).reshape(12, 16, 3))
POSTSCRIPT = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 8 8\nshowpage\n"


def chunk(name, stored, **options):
    """The dataset in one chunk that takes these bytes in the file."""

    def spoil(file):
        values = file[name][:]
        del file[name]
        dataset = file.create_dataset(name, values.shape, values.dtype, chunks=values.shape, **options)
        dataset.id.write_direct_chunk((0,) * values.ndim, stored)

    return spoil


def crumbs(file):
    """Features in a quarter of a million chunks of one value."""
    del file["resnet_feature"]
    file.create_dataset("resnet_feature", (24, 10_000), "f4", chunks=(1, 1))


def squeezed_doubles(file):
    """Features of 75 megabytes in one tenth of one."""
    del file["resnet_feature"]
    values = np.repeat(np.arange(24.0)[:, None], 6 * 2**16, 1)
    file.create_dataset("resnet_feature", data=values, compression="gzip", chunks=(24, 2**16))


def views(*last):
    """Encoded views that are good but for the last ones."""

    def spoil(file):
        stored = file.create_dataset("observation_webp", (24,), h5py.vlen_dtype(np.uint8))
        for state, data in enumerate([VIEW] * (24 - len(last)) + list(last)):
            stored[state] = np.frombuffer(data, np.uint8)

    return spoil


def picture(kind, size=(16, 12), mode="RGB"):
    """A black image as the bytes of a file."""
    buffer = io.BytesIO()
    Image.new(mode, size).save(buffer, kind)
    return buffer.getvalue()


def changed_later(name, where, value):
    """A file with a digest of which one value was changed."""

    def spoil(file):
        write_digest(file)
        file[name][where] = value

    return spoil


def digest_lost(file):
    write_digest(file)
    del file["graph"].attrs["digest"]


FOUND = {
    "a chunk of one byte with a checksum of four": chunk("graph", b"x", fletcher32=True),
    "a chunk that is too short": chunk("graph", b"x" * 767),
    "features in 240,000 chunks": crumbs,
    "float64 features that unpack to 600 times their size": squeezed_doubles,
    "8,000 goals": attribute("goals", np.arange(8000)),
    "a view that is no image": views(b"RIFF----WEBP"),
    "a view of no bytes": views(b""),
    "a view that is cut off": views(VIEW[: len(VIEW) // 2]),
    "a view in PostScript": views(POSTSCRIPT),
    "a view as a bitmap": views(picture("BMP")),
    "a view of 17 million pixels": views(picture("PNG", (4096, 4097), "1")),
    "features that are all the same": instead("resnet_feature", np.ones((24, 8), "f4")),
    "headings that are all the same": instead("rotation", np.full(24, 90)),
    "a name with a formula": attribute("name", "a $x^2$ b"),
    "a name of a dictionary's method": attribute("name", "keys"),
    "a name of another one": attribute("name", "items"),
    "a name of a network's method": attribute("name", "forward"),
    "a name of 240 letters": attribute("name", "x" * 240),
    "a name of 40 letters of three bytes": attribute("name", "室" * 40),
    "a name that is a folder": attribute("name", ".."),
    "a name of spaces": attribute("name", "  "),
    "a graph that was changed after it was written": changed_later("graph", (0, 3), 8),
    "a feature that was changed after it was written": changed_later("resnet_feature", (7, 0, 1), 0.125),
    "a pixel that was changed after it was written": changed_later("observation", (7, 0, 1, 2), 99),
    "a digest that is lost in one of two places": digest_lost,
}
