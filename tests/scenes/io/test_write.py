"""Writing dumps: what was written is read back, and a file is whole or not there."""

from dataclasses import replace

import h5py
import numpy as np
import pytest
from rooms import grid_scene, read_here

from dirl.scenes import ACTIONS, write_dump
from dirl.scenes.views import encode

DESCRIBED = {"extractor": "ResNet-50", "preprocessing": "/255", "weights": "v2"}


def pictures(states):
    return [encode(np.full((6, 8, 3), 5 * state, np.uint8)) for state in range(states)]


@pytest.mark.parametrize(("headings", "dtype"), [(12, "f4")])
def test_a_scene_is_read_back_as_it_was(tmp_path, headings, dtype):
    room = grid_scene(name="hall", headings=headings, goals=(3, 1), blocked=[(1, 0), (1, 1)])
    room = replace(room, features=room.features.astype(dtype), source="thor")
    path = tmp_path / "room.h5"
    write_dump(path, room)
    read = read_here(path)
    for name in ("graph", "positions", "headings", "features", "distances", "surrounding"):
        assert (getattr(read, name) == getattr(room, name)).all(), name
        assert getattr(read, name).dtype == getattr(room, name).dtype, name
    assert (read.name, read.goals, read.source, read.views) == ("hall", (3, 1), "thor", None)


def test_attributes_are_stored(tmp_path, scene):
    write_dump(tmp_path / "room.h5", grid_scene(width=2, depth=1))  # is replaced
    write_dump(tmp_path / "room.h5", scene, attributes={"seed": 7}, feature_attributes=DESCRIBED)
    with h5py.File(tmp_path / "room.h5") as file:
        assert file.attrs["seed"] == 7
        assert tuple(file.attrs["actions"]) == ACTIONS
    assert read_here(tmp_path / "room.h5").extractor == "ResNet-50; /255; v2"
    assert [path.name for path in tmp_path.iterdir()] == ["room.h5"]


def failing():
    yield from pictures(3)
    raise RuntimeError("the camera broke")


@pytest.mark.parametrize(("views", "says"), [(failing(), "broke"), (pictures(25), "25 views for 16 states")])
def test_a_failed_write_leaves_the_old_file_as_it_was(tmp_path, scene, views, says):
    path = tmp_path / "room.h5"
    write_dump(path, scene)
    before = path.read_bytes()
    with pytest.raises((RuntimeError, ValueError), match=says):
        write_dump(path, grid_scene(width=2), views)
    assert path.read_bytes() == before
