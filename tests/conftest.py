"""What all tests share."""

import os

os.environ["OMP_NUM_THREADS"] = "1"  # here and in every program that a test starts: they are small, and side by side

import pytest
from hypothesis import settings
from rooms import grid_scene, published_dump

# The machine may be busy, so no example is timed; the same examples every time, so a red test stays red.
settings.register_profile("dirl", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("dirl")


@pytest.fixture
def scene():
    """Six places in two rows of three, 24 states, goal 0."""
    return grid_scene()


@pytest.fixture
def dump(tmp_path, scene):
    """The room of `scene` as a file in the published layout."""
    return published_dump(tmp_path / "room.h5", scene)
