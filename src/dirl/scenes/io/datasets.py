"""Datasets of an HDF5 file: checked before their values are read, and where in the file large ones lie.

Views and patches are read later, without libhdf5. Errors do not name the file; the caller adds its name.
"""

import math
import mmap
from collections import deque
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from dirl.scenes.graph import IntArray
from dirl.scenes.scene import SceneError
from dirl.scenes.views import MAX_PIXELS, ImageError, decode

MAX_CHUNKS = 200_000
"""Of a dataset; HDF5 looks up each of them."""
MAX_CHUNK_BYTES = 2**28
"""HDF5 unpacks a whole chunk to read any value in it, and a small file can hold a chunk of gigabytes."""
MAX_FREELY_UNPACKED = 2**26
"""Bytes; what is more may only be `MAX_RATIO` times larger than it is in the file."""
MAX_RATIO = 500
"""gzip packs zeros a thousand times."""
MAX_ATTRIBUTE_BYTES = 2**20
MAX_UNPACKED_VIEWS = 2**29
"""Bytes of raw views that are compressed in the file, for they are held in memory."""
CHECKSUM_BYTES = 4
"""Of a Fletcher32 checksum. libhdf5 2.0 reads outside of its memory where a stored chunk is shorter."""
MAX_VALUES = 2**27
"""Of a mapped array: a quarter of a gigabyte."""
AT_A_TIME = 256
"""Encoded views that are read from a dataset at once."""
COLLECTIONS = 16
"""Of values of variable length, to which libhdf5 adds in turn (HDF5 file format, version 3, III.E)."""

KINDS = {"i": "integer", "u": "unsigned integer", "f": "float", "O": "byte string"}


def open_dataset(file: h5py.File, name: str, *, kinds: str, shape: tuple[int | None, ...]) -> h5py.Dataset:
    """Return a dataset whose place, type and shape are as expected; its values are not read."""
    dataset = own_dataset(file, name)
    if dataset.dtype.kind not in kinds:
        wanted = " or ".join(KINDS[kind] for kind in kinds)
        raise SceneError(f"{name}: expected {wanted} values, found {short(dataset.dtype, str)}")
    found = dataset.shape or ()
    if len(found) != len(shape) or any(w not in (None, f) for w, f in zip(shape, found, strict=True)):
        wanted = ", ".join("any" if size is None else str(size) for size in shape)
        raise SceneError(f"{name}: expected shape ({wanted}), found {found}")
    return dataset


def own_dataset(file: h5py.File, name: str) -> h5py.Dataset:
    """Return a dataset of the file itself; its values are not read."""
    if not isinstance(file.get(name, getlink=True), h5py.HardLink):
        raise SceneError(f"{name}: is a link to elsewhere; a dump must hold its own data")
    dataset = file[name]
    if not isinstance(dataset, h5py.Dataset):
        raise SceneError(f"{name}: is a {type(dataset).__name__.lower()}; expected a dataset")
    if dataset.is_virtual or dataset.external:
        raise SceneError(f"{name}: its data lies in other files; a dump must hold its own data")
    return dataset


def check_storage(dataset: h5py.Dataset, *, max_ratio: int = MAX_RATIO) -> None:
    """Check that all of a dataset's values have been written, in pieces that HDF5 can unpack.

    Args:
        dataset: of any shape.
        max_ratio: how much larger than in the file its values may be, where they are many.
    """
    name, packed = dataset.name.removeprefix("/"), dataset.id.get_storage_size()
    complete = _check_chunks(dataset, name) if dataset.chunks else bool(packed) or not dataset.size
    if not complete:
        raise SceneError(f"{name}: some of its values were never written; was its making stopped?")
    if dataset.nbytes > max(MAX_FREELY_UNPACKED, max_ratio * packed):
        raise SceneError(f"{name}: {packed} bytes would unpack to {dataset.nbytes}; no such data compresses as well")


def _check_chunks(dataset: h5py.Dataset, name: str) -> bool:
    """Check the chunks of a dataset, and the filters that they go through; whether all have been written."""
    size = math.prod(dataset.chunks) * dataset.dtype.itemsize
    if size > MAX_CHUNK_BYTES:
        raise SceneError(
            f"{name}: is stored in chunks of {dataset.chunks}, {size} bytes each; at most {MAX_CHUNK_BYTES}"
        )
    count = math.prod(-(-length // chunk) for length, chunk in zip(dataset.shape, dataset.chunks, strict=True))
    if count > MAX_CHUNKS:
        raise SceneError(f"{name}: is stored in {count} chunks; at most {MAX_CHUNKS}")
    layout = dataset.id.get_create_plist()
    filters = [layout.get_filter(index)[0] for index in range(layout.get_nfilters())]
    for code in filters:
        if not h5py.h5z.filter_avail(code):
            raise SceneError(
                f"{name}: is compressed in a way that is not installed here (HDF5 filter {code}); store it with gzip, "
                "or install the filter"
            )
    stored: list[int] = []
    if dataset.id.get_num_chunks():
        dataset.id.chunk_iter(lambda chunk: stored.append(chunk.size))
    shortest = CHECKSUM_BYTES + 1 if h5py.h5z.FILTER_FLETCHER32 in filters else 1 if filters else size
    if min(stored, default=shortest) < shortest:
        raise SceneError(f"{name}: a chunk takes {min(stored)} bytes in the file; expected at least {shortest}")
    return len(stored) >= count


def read_attribute(holder: h5py.File | h5py.Dataset, name: str) -> Any:
    """Return the value of an attribute of a plausible size; None if there is none."""
    if name not in holder.attrs:
        return None
    stored = holder.attrs.get_id(name)
    size = math.prod(stored.shape or ()) * stored.get_type().get_size()
    if size > MAX_ATTRIBUTE_BYTES:
        raise SceneError(f"attribute '{name}': takes {size} bytes; at most {MAX_ATTRIBUTE_BYTES}")
    return holder.attrs[name]


def short(value: Any, show: Any = repr) -> str:
    """Return a value of a file for a message, on one line, as Python's own type where it is NumPy's."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    text = " ".join(show(value).split())
    return text if len(text) <= 60 else f"{text[:60]}..."


def locate_mapped(file: h5py.File, path: Path, states: int) -> dict[str, tuple[int, list[int]]]:
    """Offset and shape of patches, of features and patches of further looks, and along arrows, as `Scene` names them.

    They are float16 and in one piece, so that those of many scenes can be memory-mapped.
    """
    stored: dict[str, tuple[str, tuple[int | None, ...]]] = {
        "patches": ("patches", (states, None, None)),
        "look_features": ("look_feature", (None, states, None)),
        "look_patches": ("look_patches", (None, states, None, None)),
        "along": ("along_feature", (states, None)),
    }
    found = {array: _locate(file, path, name, shape) for array, (name, shape) in stored.items() if name in file}
    if "look_patches" in found and "look_features" not in found:
        raise SceneError("look_patches: there is no look_feature; looks have features, and patches if the file has any")
    return found


def _locate(file: h5py.File, path: Path, name: str, shape: tuple[int | None, ...]) -> tuple[int, list[int]]:
    dataset = open_dataset(file, name, kinds="f", shape=shape)
    if dataset.dtype != np.float16 or 0 in dataset.shape or dataset.size > MAX_VALUES:
        raise SceneError(
            f"{name}: expected float16 values, at most {MAX_VALUES} of them, found {dataset.dtype} {dataset.shape}"
        )
    check_storage(dataset)
    offset: int | None = dataset.id.get_offset()
    if offset is None:
        raise SceneError(f"{name}: are not stored in one piece (h5repack -f {name}:NONE -l {name}:CONTI does that)")
    if offset + dataset.nbytes > path.stat().st_size:
        raise SceneError(f"{name}: the file ends before they do; it is damaged")
    return offset, list(dataset.shape)


def open_views(file: h5py.File, states: int) -> h5py.Dataset | None:
    """Return the checked dataset of views, encoded or raw; None if there is none."""
    if "observation_webp" in file:
        dataset = open_dataset(file, "observation_webp", kinds="O", shape=(states,))
        if h5py.check_vlen_dtype(dataset.dtype) != np.uint8:
            raise SceneError("observation_webp: expected byte strings (variable-length uint8)")
        check_storage(dataset)
        return dataset
    if "observation" not in file:
        return None
    dataset = open_dataset(file, "observation", kinds="u", shape=(states, None, None, 3))
    if dataset.dtype != np.uint8:
        raise SceneError(f"observation: expected uint8 pixels, found {dataset.dtype}")
    if not 0 < dataset.shape[1] * dataset.shape[2] <= MAX_PIXELS:
        raise SceneError(f"observation: expected 1 to {MAX_PIXELS} pixels a view, found shape {dataset.shape}")
    check_storage(dataset)
    if dataset.chunks is not None and dataset.nbytes > MAX_UNPACKED_VIEWS:
        raise SceneError(
            f"observation: {dataset.nbytes} bytes of raw views in chunks; more than {MAX_UNPACKED_VIEWS} must be "
            "stored in one piece (h5repack -l observation:CONTI)"
        )
    return dataset


def locate_views(dataset: h5py.Dataset, path: Path, *, decoded: bool) -> dict[str, Any]:
    """Return the arguments of `dirl.scenes.views.Views`, with ``view_`` before their names; each view is decoded once.

    ``decoded`` says that it is known that they can be.
    """
    name = dataset.name.removeprefix("/")
    if dataset.dtype.kind == "O":
        return {"view_dataset": name, "view_spans": _find_values(dataset, path, decoded=decoded)}
    start, size = dataset.id.get_offset(), dataset.nbytes // len(dataset)
    unpacked: NDArray[np.uint8] | None = None
    if start is None:  # in chunks
        start, unpacked = 0, dataset[:]
    spans = np.stack([start + size * np.arange(len(dataset)), np.full(len(dataset), size)], 1)
    return {"view_dataset": name, "view_spans": spans, "view_shape": dataset.shape[1:3], "view_unpacked": unpacked}


def _find_values(dataset: h5py.Dataset, path: Path, *, decoded: bool) -> IntArray:
    """Return the first byte and the length in the file of each encoded view, int64 ``[N, 2]``.

    libhdf5 does not tell where it finds them: each is looked for where it writes the next value of a collection, then
    behind all, then everywhere.
    """
    name, spans = dataset.name.removeprefix("/"), np.zeros((len(dataset), 2), np.int64)
    expected: deque[int] = deque([0], maxlen=COLLECTIONS)
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
        for first in range(0, len(dataset), AT_A_TIME):
            for state, values in enumerate(dataset[first : first + AT_A_TIME], first):
                value = values.tobytes()
                start = next((at for at in expected if content[at : at + len(value)] == value), -1)
                if start >= 0:
                    expected.remove(start)
                else:
                    start = content.find(value, max(expected))
                if start < 0:
                    start = content.find(value)
                if start < 0:
                    raise SceneError(f"{name}: state {state}: is not stored in one piece")
                if not decoded:
                    check_view(value, f"{name}: state {state}:")
                spans[state] = start, len(value)
                expected.appendleft(start + (len(value) + 7) // 8 * 8 + 16)
    return spans


def check_view(data: bytes, where: str) -> None:
    """Raise `SceneError` unless an encoded view can be decoded."""
    try:
        decode(data)
    except ImageError as error:
        raise SceneError(f"{where} not a readable image ({error})") from None
