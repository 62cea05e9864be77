"""The positions of values of variable length in an HDF5 file, to read them later without libhdf5."""

import mmap
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np

from dirl.scenes.graph import IntArray
from dirl.scenes.scene import SceneError

REFERENCE = np.dtype([("length", "<u4"), ("collection", "<u8"), ("object", "<u4")])
"""What a dataset holds of a value of variable length (HDF5 file format, version 3, VIII.B)."""

AT_A_TIME = 256
"""Values that are read from a dataset at once."""

Check = Callable[[int, bytes], None]
"""Given the number of a value and its bytes, raises `SceneError` if they will not do."""


def find_views(dataset: h5py.Dataset, path: Path, *, check: Check | None = None) -> IntArray:
    """The first byte and the length in the file of each value of a dataset, int64 ``[N, 2]``.

    Args:
        dataset: of variable-length uint8, ``[N]``.
        path: its file.
        check: called with each value.

    Raises:
        SceneError: a value is not in the file in one piece, or ``check`` found something.
    """
    spans = np.zeros((len(dataset), 2), np.int64)
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
        expected = _global_heap_objects(dataset, content)
        for first in range(0, len(dataset), AT_A_TIME):
            for state, values in enumerate(dataset[first : first + AT_A_TIME], first):
                value = values.tobytes()
                start = expected[state]
                if content[start : start + len(value)] != value:  # another layout than ours
                    start = content.find(value)
                if start < 0:
                    raise SceneError(f"{dataset.name.removeprefix('/')}: state {state}: is not stored in one piece")
                if check is not None:
                    check(state, value)
                spans[state] = start, len(value)
    return spans


def _global_heap_objects(dataset: h5py.Dataset, content: mmap.mmap) -> list[int]:
    """Where the values should begin by the references to them (III.E); to be compared with what libhdf5 finds."""
    start, size = dataset.id.get_offset(), len(dataset) * REFERENCE.itemsize
    if start is None or start + size > len(content):
        return [0] * len(dataset)
    references = np.frombuffer(content[start : start + size], REFERENCE)
    collections = {address: _collection(content, address) for address in set(references["collection"].tolist())}
    return [collections[address].get(number, 0) for _, address, number in references.tolist()]


def _collection(content: mmap.mmap, address: int) -> dict[int, int]:
    """Where the objects of a global heap collection begin, by their numbers."""
    objects: dict[int, int] = {}
    if content[address : address + 4] != b"GCOL":
        return objects
    end = min(address + int.from_bytes(content[address + 8 : address + 16], "little"), len(content))
    at = address + 16
    while at + 16 <= end:
        number = int.from_bytes(content[at : at + 2], "little")
        size = int.from_bytes(content[at + 8 : at + 16], "little")
        if number == 0:  # the free space at the end
            break
        objects[number] = at + 16
        at += 16 + (size + 7) // 8 * 8
    return objects
