"""Malformed dumps: each is refused by one `SceneError` that names the file, the dataset and the first bad state.

A row is what is done to a good file of 24 states, and what the message must say after the file's name.
"""

import tracemalloc

import h5py
import numpy as np
import pytest
from rooms import grid_scene
from spoil import attribute, cell, dangling, elsewhere, group, hollow, instead, no_states, refused, webp, without

from dirl.scenes import dump as dump_module
from dirl.scenes import read_dump

HUGE = 2**40
"""More states than any machine can hold; a chunked dataset of that size takes no room on the disk."""

RANGE = "states are 0..23"
SWAPPED = grid_scene().graph[:, [0, 3, 2, 1]]  # ahead, back, left, right, undeclared

ROWS = [
    # Missing datasets and wrong shapes
    (without("graph"), "the dataset 'graph' is missing; the file holds ['location', 'observation'"),
    (without("location"), "the dataset 'location' is missing"),
    (without("rotation"), "the dataset 'rotation' is missing"),
    (instead("graph", np.zeros((24, 6), int)), "graph: expected shape (any, 4), found (24, 6)"),
    (instead("graph", np.zeros(24, int)), "graph: expected shape (any, 4), found (24,)"),
    (instead("graph", h5py.Empty("i4")), "graph: expected shape (any, 4), found ()"),
    (instead("location", np.zeros((24, 3))), "location: expected shape (24, 2), found (24, 3)"),
    (instead("location", np.zeros((23, 2))), "location: expected shape (24, 2), found (23, 2)"),
    (instead("rotation", np.zeros((24, 1))), "rotation: expected shape (24), found (24, 1)"),
    (instead("resnet_feature", np.zeros((23, 8))), "resnet_feature: expected shape (24, any), found (23, 8)"),
    (instead("resnet_feature", np.zeros(24)), "resnet_feature: expected shape (24, any), found (24,)"),
    (instead("resnet_feature", np.zeros((24, 2, 2, 2))), "resnet_feature: expected shape (24, any), found (24, 2, 2"),
    (instead("resnet_feature", np.zeros((24, 0))), "resnet_feature: unusable shape (24, 0)"),
    (instead("resnet_feature", np.zeros((24, 0, 8))), "resnet_feature: unusable shape (24, 0, 8)"),
    (
        instead("shortest_path_distance", np.zeros((24, 5))),
        "shortest_path_distance: expected shape (24, 24), found (24, 5)",
    ),
    (
        instead("observation", np.zeros((24, 3, 4), "u1")),
        "observation: expected shape (24, any, any, 3), found (24, 3, 4)",
    ),
    (
        instead("observation", np.zeros((24, 3, 4, 4), "u1")),
        "observation: expected shape (24, any, any, 3), found (24, 3, 4, 4)",
    ),
    (instead("observation_webp", np.full(24, b"RIFF", "S4")), "observation_webp: expected byte string values, found"),
    (no_states, "graph: there are no states"),
    # Wrong types
    (instead("graph", np.zeros((24, 4))), "graph: expected integer or unsigned integer values, found float64"),
    (instead("graph", np.zeros((24, 4), bool)), "graph: expected integer or unsigned integer values, found bool"),
    (group("graph"), "graph: is a group; expected a dataset"),
    (group("resnet_feature"), "resnet_feature: is a group; expected a dataset"),
    (instead("location", np.full((24, 2), b"x")), "location: expected integer or unsigned integer or float values"),
    (instead("rotation", np.zeros(24, complex)), "rotation: expected integer or unsigned integer or float values"),
    (instead("resnet_feature", np.zeros((24, 8), int)), "resnet_feature: expected float values, found int64"),
    (instead("observation", np.zeros((24, 3, 4, 3), "u2")), "observation: expected uint8 pixels, found uint16"),
    (instead("observation", np.zeros((24, 3, 4, 3))), "observation: expected unsigned integer values, found float64"),
    # Values nobody can walk in
    (cell("graph", (5, 0), 24), f"graph: state 5: ahead leads to state 24, but {RANGE}"),
    (cell("graph", ([20, 9], 3), -2), f"graph: state 9: back leads to state -2, but {RANGE}"),
    (instead("graph", grid_scene().graph.astype("u4")), "graph: state 0: back leads to state 4294967295"),
    (cell("graph", (6, 1), -1), "graph: state 6: turning right is blocked"),
    (cell("graph", (7, 1), 5), "graph: state 7: turning right and back does not return to it"),
    (instead("graph", SWAPPED), "graph: state 0: turning right is blocked"),
    (instead("graph", np.full((24, 4), -1)), "graph: state 0: no state has any move"),
    (cell("resnet_feature", ([17, 3], 0, 2), np.nan), "resnet_feature: state 3 holds a value that is not finite"),
    (cell("location", (4, 1), np.inf), "location: state 4 holds a value that is not finite"),
    (
        instead("rotation", np.where(np.arange(24) == 8, np.nan, 0)),
        "rotation: state 8 holds a value that is not finite",
    ),
    (cell("location", (11, 0), 9.0), "location: state 10 is at [1.0, 0.0] but the state to its right, 11,"),
    # Attributes
    (attribute("goals", [3, 24]), f"goal 24 is not a state; {RANGE}"),
    (attribute("goals", [-1]), "goal -1 is not a state"),
    (attribute("actions", ["ahead", "right", "left", "up"]), "attribute 'actions': expected ['ahead', 'right', 'lef"),
    (attribute("actions", ["ahead", "right", "left"]), "attribute 'actions': expected"),
    (attribute("actions", ["ahead", "ahead", "left", "back"]), "attribute 'actions': expected"),
    (attribute("actions", ["ahead", "right", "left", "back", "back"]), "attribute 'actions': expected"),
    (attribute("actions", [0, 1, 2, 3]), "attribute 'actions': expected"),
    # Data that lies elsewhere
    (elsewhere("graph", "soft"), "graph: is a link to elsewhere"),
    (elsewhere("graph", "external"), "graph: is a link to elsewhere"),
    (elsewhere("resnet_feature", "soft"), "resnet_feature: is a link to elsewhere"),
    (elsewhere("resnet_feature", "external"), "resnet_feature: is a link to elsewhere"),
    (elsewhere("observation", "external"), "observation: is a link to elsewhere"),
    (elsewhere("graph", "virtual"), "graph: its data lies in other files"),
    (elsewhere("location", "virtual"), "location: its data lies in other files"),
    (elsewhere("resnet_feature", "storage"), "resnet_feature: its data lies in other files"),
    (dangling("graph"), "graph: is a link to elsewhere"),
    (dangling("observation"), "observation: is a link to elsewhere"),
    (dangling("resnet_feature"), "resnet_feature: is a link to elsewhere"),
    (instead("resnet_feature", h5py.SoftLink("/resnet_feature")), "resnet_feature: is a link"),
    (attribute("goals", "abc"), "attribute 'goals': "),
    (attribute("goals", np.nan), "attribute 'goals': "),
    (attribute("goals", [[1, 2]]), "attribute 'goals': "),
    (attribute("goals", h5py.Empty("i8")), "attribute 'goals': "),
    (attribute("goals", [1.5]), "attribute 'goals': "),
    (attribute("name", np.bytes_(b"\xff\xfe")), "attribute 'name': "),
    (webp(h5py.string_dtype()), "observation_webp: expected"),
    (webp(h5py.ref_dtype), "observation_webp: expected"),
    (instead("resnet_feature", np.full((24, 8), 1e300)), "resnet_feature: state 0 "),
]


def str_only(value):
    return value if isinstance(value, str) else ""


@pytest.mark.parametrize(("spoil", "says"), ROWS, ids=str_only)
def test_a_malformed_dump_is_refused(dump, spoil, says):
    with h5py.File(dump, "a") as file:
        spoil(file)
    assert refused(dump).startswith(says)


ABSURD = [
    (hollow("graph", (HUGE, 4), "i4"), f"graph: {HUGE} states are more than the 50000"),
    (hollow("location", (HUGE, 2)), "location: expected shape (24, 2)"),
    (hollow("rotation", (HUGE,)), "rotation: expected shape (24)"),
    (hollow("resnet_feature", (24, HUGE)), f"resnet_feature: unusable shape (24, {HUGE})"),
    (hollow("resnet_feature", (24, 2, HUGE)), f"resnet_feature: unusable shape (24, 2, {HUGE})"),
    (hollow("resnet_feature", (HUGE, 1, 8)), "resnet_feature: expected shape (24, any, any)"),
    (hollow("shortest_path_distance", (HUGE, HUGE)), "shortest_path_distance: expected shape (24, 24)"),
    (hollow("observation", (HUGE, 3, 4, 3), "u1"), "observation: expected shape (24, any, any, 3)"),
    (hollow("observation", (24, HUGE, 4, 3), "u1"), "observation: unusable"),
]


@pytest.mark.parametrize(("spoil", "says"), ABSURD, ids=str_only)
def test_absurd_sizes_are_refused_before_memory_is_taken(dump, spoil, says):
    with h5py.File(dump, "a") as file:
        spoil(file)
    tracemalloc.start()
    try:
        assert refused(dump).startswith(says)
        assert tracemalloc.get_traced_memory()[1] < 10 * 2**20
    finally:
        tracemalloc.stop()


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
    allowed = {"MAX_STATES": 24, "MAX_FEATURE_VALUES": 24 * 10 * 16}[limit]
    monkeypatch.setattr(dump_module, limit, allowed)
    assert len(read_dump(dump)) == 24
    monkeypatch.setattr(dump_module, limit, allowed - 1)
    refused(dump)
