"""Where the large contents of a dump lie in its file: views and patches are read later, without libhdf5."""

import mmap
from collections import deque
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
from numpy.typing import NDArray

from dirl.scenes.graph import IntArray
from dirl.scenes.io.storage import check_storage, open_dataset
from dirl.scenes.scene import SceneError
from dirl.scenes.views import MAX_PIXELS, ImageError, decode

MAX_VALUES = 2**27
"""Of a mapped array: a quarter of a gigabyte."""

MAX_UNPACKED_VIEWS = 2**29
"""Bytes of raw views that are compressed in the file, for they are held in memory."""

AT_A_TIME = 256
"""Encoded views that are read from a dataset at once."""

COLLECTIONS = 16
"""Of values of variable length, to which libhdf5 adds in turn (HDF5 file format, version 3, III.E)."""


class Located(NamedTuple):
    """Where an array lies in a file."""

    offset: int
    """Of its first byte."""
    shape: list[int]


def locate_mapped(file: h5py.File, path: Path, states: int) -> dict[str, Located]:
    """Where patches, and features and patches of further looks, lie in a file that has them. They are not read.

    They are float16 and in one piece, so that those of many scenes can be memory-mapped.

    Raises:
        SceneError: one has another type or shape, is not stored in one piece, or does not go with the others.
    """
    shapes: dict[str, tuple[int | None, ...]] = {
        "patches": (states, None, None),
        "look_feature": (None, states, None),
        "look_patches": (None, states, None, None),
    }
    found = {name: _locate(file, path, name, shape) for name, shape in shapes.items() if name in file}
    if "look_patches" in found and "look_feature" not in found:
        raise SceneError("look_patches: there is no look_feature; looks have features, and patches if the file has any")
    return found


def _locate(file: h5py.File, path: Path, name: str, shape: tuple[int | None, ...]) -> Located:
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
    return Located(offset, list(dataset.shape))


def map_array(path: Path, located: Located | None) -> NDArray[np.float16] | None:
    """An array that `locate_mapped` found, read when it is used; None if there is none."""
    return None if located is None else np.memmap(path, np.float16, "r", located[0], tuple(located[1]))


def open_views(file: h5py.File, states: int) -> h5py.Dataset | None:
    """The checked dataset of views, encoded or raw; None if there is none."""
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


def locate_views(dataset: h5py.Dataset | None, path: Path, *, decoded: bool) -> dict[str, Any]:
    """What `dirl.scenes.views.Views` is made of; each view is decoded once, unless it is known that it can be."""
    spans, shape, unpacked = np.empty((0, 2), np.int64), None, None
    if dataset is not None and dataset.dtype.kind == "O":
        spans = _find_values(dataset, path, decoded=decoded)
    elif dataset is not None:
        shape = list(dataset.shape[1:3])
        start, size = dataset.id.get_offset(), dataset.nbytes // len(dataset)
        if start is None:  # in chunks
            unpacked = dataset[:]
            start = 0
        spans = np.stack([start + size * np.arange(len(dataset)), np.full(len(dataset), size)], 1)
    name = "" if dataset is None else dataset.name.removeprefix("/")
    return {"view_dataset": name, "view_spans": spans, "view_shape": shape, "views_unpacked": unpacked}


def _find_values(dataset: h5py.Dataset, path: Path, *, decoded: bool) -> IntArray:
    """The first byte and the length in the file of each encoded view, int64 ``[N, 2]``.

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
                    _check_view(name, state, value)
                spans[state] = start, len(value)
                expected.appendleft(start + (len(value) + 7) // 8 * 8 + 16)
    return spans


def _check_view(name: str, state: int, data: bytes) -> None:
    try:
        decode(data)
    except ImageError as error:
        raise SceneError(f"{name}: state {state}: not a readable image ({error})") from None
