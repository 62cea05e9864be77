"""Checks of an HDF5 file: the place, type, shape and storage of every dataset, before its values are read.

Errors do not name the file; the caller adds its name.
"""

import math
from typing import Any

import h5py

from dirl.scenes.scene import SceneError

MAX_CHUNKS = 200_000
"""Of a dataset; HDF5 looks up each of them."""
MAX_CHUNK_BYTES = 2**28
"""HDF5 unpacks a whole chunk to read any value in it, and a small file can hold a chunk of gigabytes."""
MAX_FREELY_UNPACKED = 2**26
"""Bytes; what is more may only be `MAX_RATIO` times larger than it is in the file."""
MAX_RATIO = 500
"""gzip packs zeros a thousand times."""
MAX_ATTRIBUTE_BYTES = 2**20
CHECKSUM_BYTES = 4
"""Of a Fletcher32 checksum. libhdf5 2.0 reads outside of its memory where a stored chunk is shorter."""

KINDS = {"i": "integer", "u": "unsigned integer", "f": "float", "O": "byte string"}


def open_dataset(file: h5py.File, name: str, *, kinds: str, shape: tuple[int | None, ...]) -> h5py.Dataset:
    """A dataset whose place, type and shape are as expected; its values are not read."""
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
    """A dataset of the file itself; its values are not read."""
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
    name = dataset.name.removeprefix("/")
    if dataset.chunks is None:
        complete = bool(dataset.id.get_storage_size()) or not dataset.size
    else:
        complete = _check_chunks(dataset, name)
    if not complete:
        raise SceneError(f"{name}: some of its values were never written; was its making stopped?")
    packed = dataset.id.get_storage_size()
    if dataset.nbytes > max(MAX_FREELY_UNPACKED, max_ratio * packed):
        raise SceneError(f"{name}: {packed} bytes would unpack to {dataset.nbytes}; no such data compresses as well")


def _check_chunks(dataset: h5py.Dataset, name: str) -> bool:
    """Check the chunks of a dataset; whether all of them have been written."""
    size = math.prod(dataset.chunks) * dataset.dtype.itemsize
    if size > MAX_CHUNK_BYTES:
        raise SceneError(
            f"{name}: is stored in chunks of {dataset.chunks}, {size} bytes each; at most {MAX_CHUNK_BYTES}"
        )
    count = math.prod(-(-length // chunk) for length, chunk in zip(dataset.shape, dataset.chunks, strict=True))
    if count > MAX_CHUNKS:
        raise SceneError(f"{name}: is stored in {count} chunks; at most {MAX_CHUNKS}")
    filters = _filters(dataset, name)
    stored: list[int] = []
    if dataset.id.get_num_chunks():
        dataset.id.chunk_iter(lambda chunk: stored.append(chunk.size))
    shortest = CHECKSUM_BYTES + 1 if h5py.h5z.FILTER_FLETCHER32 in filters else 1 if filters else size
    short_ones = [found for found in stored if found < shortest]
    if short_ones:
        raise SceneError(f"{name}: a chunk takes {short_ones[0]} bytes in the file; expected at least {shortest}")
    return len(stored) >= count


def _filters(dataset: h5py.Dataset, name: str) -> list[int]:
    """The codes of the filters that a dataset's chunks go through, all of them installed."""
    layout = dataset.id.get_create_plist()
    filters = [layout.get_filter(index)[0] for index in range(layout.get_nfilters())]
    for code in filters:
        if not h5py.h5z.filter_avail(code):
            raise SceneError(
                f"{name}: is compressed in a way that is not installed here (HDF5 filter {code}); store it with gzip, "
                "or install the filter"
            )
    return filters


def read_attribute(holder: h5py.File | h5py.Dataset, name: str) -> Any:
    """The value of an attribute of a plausible size; None if there is none."""
    if name not in holder.attrs:
        return None
    stored = holder.attrs.get_id(name)
    size = math.prod(stored.shape or ()) * stored.get_type().get_size()
    if size > MAX_ATTRIBUTE_BYTES:
        raise SceneError(f"attribute '{name}': takes {size} bytes; at most {MAX_ATTRIBUTE_BYTES}")
    return holder.attrs[name]


def short(value: Any, show: Any = repr) -> str:
    """A value of a file for a message, on one line, as Python's own type where it is NumPy's."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    text = " ".join(show(value).split())
    return text if len(text) <= 60 else f"{text[:60]}..."
