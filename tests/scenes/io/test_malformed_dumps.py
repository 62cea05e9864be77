"""Malformed dumps: each is refused by one `SceneError` that names the file, the dataset and the first bad state."""

import tracemalloc

import h5py
import pytest
from malformed import ABSURD, MALFORMED, PAGE, make, page
from spoil import hollow, refused

from dirl.scenes import read_dump
from dirl.scenes.io import read as dump_module


@pytest.mark.parametrize("what", MALFORMED)
def test_a_malformed_dump_is_refused(tmp_path, what):
    spoil, says = MALFORMED[what]
    assert refused(make(tmp_path / "room.h5", spoil)).startswith(says)


@pytest.mark.parametrize("what", ABSURD)
def test_absurd_sizes_are_refused_before_memory_is_taken(tmp_path, what):
    path = make(tmp_path / "room.h5", ABSURD[what][0])
    tracemalloc.start()
    try:
        refused(path)
        assert tracemalloc.get_traced_memory()[1] < 10 * 2**20
    finally:
        tracemalloc.stop()


def test_the_documentation_shows_every_message_as_it_is():
    assert len(MALFORMED) >= 40
    assert PAGE.read_text() == page(), "run python tests/malformed.py"


def test_features_that_are_too_many_in_all_are_refused(dump):
    with h5py.File(dump, "a") as file:
        for name, shape, dtype in (
            ("graph", (400_000, 4), "i4"),
            ("location", (400_000, 2), "f4"),
            ("rotation", (400_000,), "f4"),
            ("resnet_feature", (400_000, 1, 65_536), "f4"),
        ):
            hollow(name, shape, dtype)(file)
    refused(dump)


@pytest.mark.parametrize("limit", ["MAX_STATES", "MAX_FEATURE_VALUES"])
def test_the_limits_themselves_are_allowed(dump, monkeypatch, limit):
    allowed = {"MAX_STATES": 24, "MAX_FEATURE_VALUES": 24 * 16}[limit]
    monkeypatch.setattr(dump_module, limit, allowed)
    assert len(read_dump(dump)) == 24
    monkeypatch.setattr(dump_module, limit, allowed - 1)
    refused(dump)
