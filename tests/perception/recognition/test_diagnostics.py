"""What inspect finds in scenes that have something to find, and its pictures."""

from dataclasses import replace

import numpy as np
import pytest
from rooms import grid_scene, renumbered

from dirl.perception.recognition.diagnostics import inspect_scene
from dirl.perception.recognition.learned import Learned
from dirl.perception.recognition.recogniser import TemplateStop
from dirl.scenes import SceneError, read_dump, write_dump
from dirl.scenes.views import encode


def with_views(folder, room, view=None):
    """The room with noise as its views, or as ``view`` gives them."""
    rng = np.random.default_rng(7)
    views = [rng.integers(0, 256, (30, 40, 3), np.uint8) if view is None else view(s) for s in range(len(room))]
    write_dump(folder / "room.h5", room, map(encode, views))
    return read_dump(folder / "room.h5")


def test_a_good_room_has_no_problems(tmp_path):
    room = grid_scene(3, 2, headings=12, goals=(0, 13), blocked=[(1, 0)], feature_width=64)
    found = inspect_scene(with_views(tmp_path, renumbered(room, np.random.default_rng(1).permutation(len(room)))))
    assert found.problems == []
    assert found.parts.tolist() == [0] * len(room)
    assert found.ambiguous == []
    facts = {"states": "60", "places": "5", "turn": "30 degrees", "step": "0.50 m", "parts": "1"}
    facts |= {"extent": "1.5 x 1.0 m", "views": "30x40", "features": "64 float32", "extractor": "random"}
    assert {**facts, "farthest pair": f"{room.distances.max()} actions"}.items() <= found.facts.items()


def test_parts_that_are_not_connected_are_found():
    room = grid_scene(4, 2, blocked=[(2, 0), (2, 1)], goals=(20,))
    found = inspect_scene(room)
    assert found.parts.tolist() == [0] * 8 + [1] * 4 + [0] * 8 + [1] * 4
    assert found.facts["parts"] == "2 (states: 16, 8)"
    text = "\n".join(found.problems)
    assert "state 8 (at x 1.50, z 0.00) and 7 more are not connected with the largest part" in text
    assert "goal 20 lies outside the largest part" in text


def test_a_problem_names_the_first_state_and_what_to_do():
    for name, where, value, says in (
        ("graph", (0, 0), -1, "state 12: a move back leads to state 0, and the opposite move does not"),
        ("headings", [5, 6], 0, "state 4: a turn goes from heading 0 to 0, but a full circle has 4 turns (3 "),
        ("positions", slice(None), 0, "a move ahead leads to state 12 at the same location (14 such moves)"),
        ("features", 9, 2.5, "state 9 has features that are all equal (1 such states): encode anew"),
    ):
        values = getattr(grid_scene(), name).copy()
        values[where] = value
        assert says in "\n".join(inspect_scene(replace(grid_scene(goals=()), **{name: values})).problems)


def test_views_that_show_nothing_or_the_same_twice_are_found(tmp_path):
    def view(state):
        if state == 7:
            return np.full((30, 40, 3), 99, np.uint8)
        return np.random.default_rng(99 if state in (11, 12) else state).integers(0, 256, (30, 40, 3), np.uint8)

    text = "\n".join(inspect_scene(with_views(tmp_path, grid_scene(), view)).problems)
    assert "state 7 sees next to nothing (1 blank views)" in text
    assert "state 12 has the very same view as state 11 (1 such states)" in text


def test_ambiguous_pairs_are_found_worst_first():
    """Places 0 and 5 look the same, or nearly."""
    room = grid_scene(goals=(0, 9), feature_width=64)
    features = room.features.copy()
    features[20:] = features[:4]
    features[23] += 0.1 * np.random.default_rng(0).random(64, np.float32)
    found = inspect_scene(replace(room, features=features), TemplateStop())
    pairs = [(a, b, distance) for a, b, _, distance in found.ambiguous]
    assert sorted(pairs) == [(s, s + 20, room.distances[s, s + 20]) for s in range(4)]
    scores = [score for _, _, score, _ in found.ambiguous]
    assert scores == sorted(scores, reverse=True)
    text = "\n".join(found.problems)
    assert "(4 pairs above 0.9): on its way to one an agent stops at the other" in text
    assert "goal 0 is taken for reached in 1 other states, most in state 20 (" in text
    assert "goal 9" not in text


def test_any_recogniser_finds_ambiguous_states():
    """Two states that one recogniser tells apart by their patches have the same pooled features."""
    rng = np.random.default_rng(0)
    room = grid_scene(goals=(0, 9), feature_width=1280)
    patches = rng.normal(size=(len(room), 8, 96)).astype(np.float16)
    patches[20] = patches[3]
    found = inspect_scene(replace(room, patches=patches), TemplateStop(0.0, "front", Learned()))
    assert found.ambiguous[0][:2] == (3, 20)
    with pytest.raises(SceneError, match="grid_scene: has no patches, which the recogniser compares"):
        inspect_scene(room, TemplateStop(0.0, "front", Learned()))
