"""Patches in a dump: written, mapped into memory, replaced, and refused where they are malformed."""

from dataclasses import replace

import h5py
import numpy as np
import pytest
from rooms import grid_scene, read_here

from dirl.scenes import SceneError, write_dump

PATCHES = np.random.default_rng(0).normal(size=(24, 8, 6)).astype(np.float16)


@pytest.fixture
def room(tmp_path):
    write_dump(tmp_path / "room.h5", replace(grid_scene(), patches=PATCHES), patch_attributes={"projection": "none"})
    return tmp_path / "room.h5"


def test_patches_come_back_from_a_map_of_the_file(room):
    scene = read_here(room)
    assert (scene.patches == PATCHES).all()
    base = scene.patches
    while not isinstance(base, np.memmap):
        base = base.base
    assert base.mode == "r"
    assert not scene.patches.flags.writeable
    with h5py.File(room) as file:
        assert file["patches"].attrs["projection"] == "none"


def test_patches_that_cannot_be_mapped_are_refused(room):
    with h5py.File(room, "a") as file:
        del file["patches"]
        file.create_dataset("patches", data=PATCHES, chunks=(24, 8, 6))
    with pytest.raises(SceneError, match=r"patches: are not stored in one piece \(h5repack .*\)"):
        read_here(room)
