"""Large float16 arrays of a dump: in one piece and memory-mapped, so that those of many scenes need no memory."""

from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np
from numpy.typing import NDArray

from dirl.scenes.io.storage import check_storage, open_dataset
from dirl.scenes.scene import SceneError

MAX_VALUES = 2**27
"""A quarter of a gigabyte."""

MAPPED = ("patches", "look_feature", "look_patches")
"""Patches of the default look; features and patches of further looks."""


class Located(NamedTuple):
    """Where an array lies in a file."""

    offset: int
    """Of its first byte."""
    shape: list[int]


def locate_mapped(file: h5py.File, path: Path, states: int) -> dict[str, Located]:
    """Where those of `MAPPED` that a file has lie in it. They are not read.

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
