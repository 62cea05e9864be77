"""Patches in a dump: written, mapped into memory, replaced, and refused where they are malformed."""

import os
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from rooms import grid_scene, read_here

from dirl.scenes import SceneError, write_dump
from dirl.scenes.io.hdf5 import read_contents

PATCHES = np.random.default_rng(0).normal(size=(24, 8, 6)).astype(np.float16)


@pytest.fixture
def room(tmp_path):
    write_dump(tmp_path / "room.h5", replace(grid_scene(), patches=PATCHES), patch_attributes={"projection": "none"})
    return tmp_path / "room.h5"


def without_digest(file):
    """As if another program had written it."""
    del file.attrs["digest"], file["graph"].attrs["digest"]


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


def test_patches_that_the_file_does_not_hold_are_refused(room, monkeypatch):
    with h5py.File(room) as file:
        end = file["patches"].id.get_offset() + PATCHES.nbytes
        cut = os.stat_result((0,) * 6 + (end - 1,) + (0,) * 3)
        monkeypatch.setattr(Path, "stat", lambda *_, **__: cut)
        with pytest.raises(SceneError, match="patches: the file ends before they do"):
            read_contents(room)


@pytest.mark.parametrize(
    ("patches", "says"),
    [
        (PATCHES[:5], r"patches: expected shape \(24, any, any\), found \(5, 8, 6\)"),
        (PATCHES.astype(np.float32), r"patches: expected float16 values, .* found float32"),
    ],
)
def test_malformed_patches_are_told_in_one_line(room, patches, says):
    with h5py.File(room, "a") as file:
        del file["patches"]
        file["patches"] = patches
        without_digest(file)
    with pytest.raises(SceneError, match=says) as caught:
        read_here(room)
    assert "\n" not in str(caught.value)
