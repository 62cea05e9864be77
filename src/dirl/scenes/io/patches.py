"""Patches in a dump: stored contiguously and memory-mapped, so that those of many scenes need no memory."""

from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from dirl.scenes.io.storage import check_storage, open_dataset
from dirl.scenes.scene import SceneError

MAX_VALUES = 2**27
"""A quarter of a gigabyte."""


def locate_patches(file: h5py.File, path: Path, states: int) -> tuple[int, list[int] | None]:
    """Where the patches of a file begin, in bytes, and their shape; None if there are none. They are not read.

    Raises:
        SceneError: they have another type or shape, or are not stored in one piece.
    """
    if "patches" not in file:
        return 0, None
    dataset = open_dataset(file, "patches", kinds="f", shape=(states, None, None))
    if dataset.dtype != np.float16 or 0 in dataset.shape or dataset.size > MAX_VALUES:
        raise SceneError(
            f"patches: expected float16 values, at most {MAX_VALUES} of them, found {dataset.dtype} {dataset.shape}"
        )
    check_storage(dataset)
    offset: int | None = dataset.id.get_offset()
    if offset is None:
        raise SceneError("patches: are not stored in one piece (h5repack -f patches:NONE -l patches:CONTI does that)")
    if offset + dataset.nbytes > path.stat().st_size:
        raise SceneError("patches: the file ends before they do; it is damaged")
    return offset, list(dataset.shape)


def map_patches(path: Path, offset: int, shape: list[int] | None) -> NDArray[np.float16] | None:
    """The patches that `locate_patches` found: ``[N, cells, channels]``, read when they are used."""
    return None if shape is None else np.memmap(path, np.float16, "r", offset, tuple(shape))
