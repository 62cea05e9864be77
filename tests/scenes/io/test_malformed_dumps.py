"""Malformed dumps: each is refused by one `SceneError` that names the file, the dataset and the first bad state."""

import tracemalloc

import h5py
import numpy as np
import pytest
from malformed import ABSURD, BEGIN, MALFORMED, PAGE, hollow, make, refused, row
from rooms import read_here

from dirl.scenes.io import hdf5


@pytest.mark.parametrize("what", MALFORMED)
def test_a_malformed_dump_is_refused_in_the_words_of_the_documentation(tmp_path, what):
    assert row(what, refused(make(tmp_path / "room.h5", MALFORMED[what]))) in PAGE.read_text().splitlines()


@pytest.mark.parametrize("what", ABSURD)
def test_absurd_sizes_are_refused_before_memory_is_taken(tmp_path, what):
    path = make(tmp_path / "room.h5", ABSURD[what])
    tracemalloc.start()
    try:
        refused(path)
        assert tracemalloc.get_traced_memory()[1] < 10 * 2**20
    finally:
        tracemalloc.stop()


def test_the_documentation_has_one_row_for_every_file():
    about, _, rows = PAGE.read_text().partition(BEGIN)
    assert [line.split(" | ")[0] for line in rows.splitlines()[1:]] == [f"| {what}" for what in MALFORMED]
    assert f"has {len(MALFORMED)} damaged files" in about


def test_many_goals_are_refused(dump):
    """Comparing each with all others took minutes."""
    with h5py.File(dump.with_name("new.h5"), "w", libver="latest") as new, h5py.File(dump) as old:
        for name in old:
            old.copy(name, new)
        new.attrs["goals"] = np.arange(64_000)
    assert refused(dump.with_name("new.h5")) == "attribute 'goals': names 64000 goals of 24 states"


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
    monkeypatch.setattr(hdf5, limit, allowed)
    assert len(read_here(dump)) == 24
    monkeypatch.setattr(hdf5, limit, allowed - 1)
    refused(dump)
