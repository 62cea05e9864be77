"""Malformed dumps: what is done to a good file of 24 states; each way to spoil one is given the open file.

What the one error says is in docs/howto/malformed_dumps.md; ``python tests/helpers/malformed.py`` writes its table.
"""

import io
import re
import sys
import tempfile
from pathlib import Path

import h5py
import numpy as np
import pytest
from PIL import Image
from rooms import grid_scene, published_dump

from dirl.scenes import SceneError, read_dump
from dirl.scenes.io.digest import write_digest
from dirl.scenes.views import encode

PAGE = Path(__file__).parents[2] / "docs" / "howto" / "malformed_dumps.md"
BEGIN = "| file | message |\n|---|---|"
"""Of the table, which is the end of the page."""

HUGE = 2**40
"""More states than any machine can hold; a chunked dataset of that size takes no room on the disk."""

TURN_OF_SIX = np.array([[-1, (i + 1) % 6 + 6 * (i // 6), (i - 1) % 6 + 6 * (i // 6), -1] for i in range(24)])
UNEVEN = np.array([[-1, (i + 1) % 4, (i - 1) % 4, -1] for i in range(4)])
UNEVEN = np.concatenate([UNEVEN, [[-1, 4 + (i + 1) % 20, 4 + (i - 1) % 20, -1] for i in range(20)]])
RING = np.array([[-1, (i + 1) % 400, (i - 1) % 400, -1] for i in range(400)])


def without(name):
    return lambda file: file.pop(name)


def instead(name, value):
    def spoil(file):
        file.pop(name, None)
        file[name] = value

    return spoil


def cell(name, where, value):
    def spoil(file):
        values = file[name][:]
        values[where] = value
        instead(name, values)(file)

    return spoil


def attribute(name, value):
    return lambda file: file.attrs.update({name: value})


def hollow(name, shape, dtype="f4"):
    """A dataset of that shape that was never filled."""

    def spoil(file):
        file.pop(name, None)
        file.create_dataset(name, shape, dtype, chunks=tuple(min(size, 64) for size in shape))

    return spoil


def elsewhere(name, kind):
    """The dataset's values lie in another (existing, good) file or under another name."""

    def spoil(file):
        shape, dtype = file[name].shape, file[name].dtype
        another = file.filename + ".other"
        with h5py.File(another, "w") as other:
            other[name] = file[name][:]
        file.move(name, "hidden")
        if kind == "virtual":
            layout = h5py.VirtualLayout(shape, dtype)
            layout[:] = h5py.VirtualSource(another, name, shape)
            file.create_virtual_dataset(name, layout)
        elif kind == "storage":
            with open(file.filename + ".raw", "wb") as raw:
                raw.write(file["hidden"][:].tobytes())
            file.create_dataset(name, shape, dtype, external=[(file.filename + ".raw", 0, h5py.h5f.UNLIMITED)])
        else:
            file[name] = h5py.SoftLink("/hidden") if kind == "soft" else h5py.ExternalLink(another, name)

    return spoil


def group(name):
    def spoil(file):
        del file[name]
        file.create_group(name)

    return spoil


def no_states(file):
    for name in ("resnet_feature", "observation", "shortest_path_distance"):
        del file[name]
    for name, shape in (("graph", (0, 4)), ("location", (0, 2)), ("rotation", (0,))):
        instead(name, np.zeros(shape, int))(file)


def webp(dtype):
    return lambda file: file.create_dataset("observation_webp", (24,), dtype)


def feature_attribute(name, value):
    return lambda file: file["resnet_feature"].attrs.update({name: value})


def of_states(graph):
    """The graph instead of the file's own, and everything else of as many states as it has."""

    def spoil(file):
        no_states(file)
        for name, value in (
            ("graph", graph),
            ("location", np.zeros((len(graph), 2))),
            ("rotation", np.arange(len(graph)) % 360),
        ):
            instead(name, value)(file)

    return spoil


def partly_written(name):
    """Only the first chunk of four has been written."""

    def spoil(file):
        del file[name]
        dataset = file.create_dataset(name, (24, 8), "f4", chunks=(6, 8))
        dataset[:6] = 1.0

    return spoil


def refused(path):
    """What the one `SceneError` says after the name of the file."""
    with pytest.raises(SceneError) as caught:
        read_dump(path, isolated=False)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert caught.value.__cause__ is None
    assert caught.value.__context__ is None or caught.value.__suppress_context__  # one error, not a chain
    assert "\n" not in message
    return message.removeprefix(f"{path}: ")


VIEW = encode(np.arange(12 * 16 * 3, dtype=np.uint8).reshape(12, 16, 3))
POSTSCRIPT = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 8 8\nshowpage\n"


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


SHAPES = {
    "no `graph`": without("graph"),
    "`graph` of six actions": instead("graph", np.zeros((24, 6), int)),
    "`graph` empty": instead("graph", h5py.Empty("i4")),
    "`location` with a height": instead("location", np.zeros((24, 3))),
    "`rotation` of two dimensions": instead("rotation", np.zeros((24, 1))),
    "`resnet_feature` of one state fewer": instead("resnet_feature", np.zeros((23, 8))),
    "`resnet_feature` not pooled": instead("resnet_feature", np.zeros((24, 2, 2, 2))),
    "`resnet_feature` of width 0": instead("resnet_feature", np.zeros((24, 0))),
    "distances of some goals only": instead("shortest_path_distance", np.zeros((24, 5))),
    "grey views": instead("observation", np.zeros((24, 3, 4), "u1")),
    "no states": no_states,
}

TYPES = {
    "`graph` of floats": instead("graph", np.zeros((24, 4))),
    "`graph` is a group": group("graph"),
    "`location` of texts": instead("location", np.full((24, 2), b"x")),
    "views of 16 bits": instead("observation", np.zeros((24, 3, 4, 3), "u2")),
    "encoded views as texts": webp(h5py.string_dtype()),
}

VALUES = {
    "a link to a state that is not there": cell("graph", (5, 0), 24),
    "a link of -2": cell("graph", ([20, 9], 3), -2),
    "-1 stored as an unsigned 64-bit number": instead("graph", grid_scene().graph.astype("u8")),
    "a right turn that is blocked": cell("graph", (6, 1), -1),
    "a right turn that is one-way": cell("graph", (7, 1), 5),
    "columns in another order, undeclared": instead("graph", grid_scene().graph[:, [0, 3, 2, 1]]),
    "turns of 60 degrees": instead("graph", TURN_OF_SIX),
    "different turns at different places": instead("graph", UNEVEN),
    "a ring of 400 turns": of_states(RING),
    "a turn that moves the agent": cell("location", (11, 0), 9.0),
    "a location that is infinite": cell("location", (4, 1), np.inf),
    "a location on the moon": cell("location", (4, 1), 4e12),
    "a rotation that is NaN": instead("rotation", np.where(np.arange(24) == 8, np.nan, 0)),
    "features with NaN": cell("resnet_feature", ([17, 3], 0, 2), np.nan),
    "features of 1e38": instead("resnet_feature", np.full((24, 8), 1e38)),
    "features before the crops": instead("resnet_feature", np.zeros((24, 8, 2), np.float32)),
    "features that overflow float32": instead("resnet_feature", np.full((24, 8), 1e300)),
}

ATTRIBUTES = {
    "a goal beyond the states": attribute("goals", [3, 24]),
    "a goal named twice": attribute("goals", [3, 4, 3]),
    "goals as text": attribute("goals", "abc"),
    "goals as a table": attribute("goals", [[1, 2]]),
    "an unknown action": attribute("actions", ["ahead", "right", "left", "up"]),
    "three actions": attribute("actions", ["ahead", "right", "left"]),
    "a name that is not UTF-8": attribute("name", np.bytes_(b"\xff\xfe")),
    "a name that is a number": attribute("name", 7),
    "a name with slashes": attribute("name", "../../etc/room"),
    "a source of two lines": attribute("source", "thor\nrooms"),
    "an extractor that is a list": feature_attribute("extractor", [1, 2]),
}

STORAGE = {
    "`graph` is a soft link": elsewhere("graph", "soft"),
    "`graph` is an external link": elsewhere("graph", "external"),
    "`graph` is a virtual dataset": elsewhere("graph", "virtual"),
    "features stored in another file": elsewhere("resnet_feature", "storage"),
    "features never written": hollow("resnet_feature", (24, 8)),
    "features written by half": partly_written("resnet_feature"),
}

ABSURD = {
    "a trillion states": hollow("graph", (HUGE, 4), "i4"),
    "a trillion features": hollow("resnet_feature", (24, HUGE)),
    "views a trillion pixels high": hollow("observation", (24, HUGE, 4, 3), "u1"),
}

FOUND = {
    "8,000 goals": attribute("goals", np.arange(8000)),
    "a view that is no image": views(b"RIFF----WEBP"),
    "a view in PostScript": views(POSTSCRIPT),
    "a view of 17 million pixels": views(picture("PNG", (4096, 4097), "1")),
    "a name of a dictionary's method": attribute("name", "keys"),
    "a name of 240 letters": attribute("name", "x" * 240),
    "a name that is a folder": attribute("name", ".."),
    "a graph that was changed after it was written": changed_later("graph", (0, 3), 8),
    "a pixel that was changed after it was written": changed_later("observation", (7, 0, 1, 2), 99),
    "a digest that is lost in one of two places": digest_lost,
}
"""Once they crashed, hung, took memory, or failed long after they were read."""

MALFORMED = {**SHAPES, **TYPES, **VALUES, **ATTRIBUTES, **STORAGE, **ABSURD, **FOUND}


def make(path, spoil):
    """A good file of 24 states, spoiled."""
    published_dump(path, grid_scene())
    with h5py.File(path, "a") as file:
        spoil(file)
    return path


def row(what, message):
    """The line of the table about a file."""
    escaped = message.replace("|", "\\|")
    return f"| {what} | {escaped} |"


def page():
    """The page with the table of all malformed files and their messages, Markdown."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for number, (what, spoil) in enumerate(MALFORMED.items()):
            rows.append(row(what, refused(make(Path(folder) / f"{number}.h5", spoil))))
    about = re.sub(r"has \d+ damaged files", f"has {len(rows)} damaged files", PAGE.read_text().partition(BEGIN)[0])
    return "\n".join([about + BEGIN, *rows, ""])


if __name__ == "__main__":
    sys.stdout.write(f"{PAGE}: {PAGE.write_text(page())} characters\n")
