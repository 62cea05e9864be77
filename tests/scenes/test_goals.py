"""Goals by rule, and places held out of the training."""

from dataclasses import replace

import numpy as np
import pytest
from refusals import refused
from rooms import grid_scene

from dirl.scenes import make_world
from dirl.scenes.goals import choose_goals
from dirl.scenes.graph import places


def states(chosen):
    """The trained goals of the one scene."""
    return np.array(chosen.trained["grid"])


def test_all_and_every_n_th_state_become_goals(scene):
    assert states(choose_goals([scene], "all")).tolist() == list(range(24))
    assert states(choose_goals([scene], "every:5")).tolist() == [0, 5, 10, 15, 20]


def test_a_share_is_of_whole_places_drawn_by_the_seed(scene):
    place = places(scene.graph)
    chosen = [states(choose_goals([scene], "fraction:0.5", seed=seed)) for seed in range(4)]
    for one in chosen:
        assert len(one) == 12
        assert np.isin(place, place[one]).sum() == 12
    assert len({tuple(one) for one in chosen}) > 1
    assert set(chosen[0]) <= set(states(choose_goals([scene], "fraction:0.8", seed=0)))


@pytest.mark.parametrize("rule", ["fraction:0.5", [0, 13]])
def test_places_held_out_are_never_trained(scene, rule):
    chosen = choose_goals([scene], rule, hold_out=1 / 3, seed=2)
    held, place = np.array(chosen.held_out["grid"]), places(scene.graph)
    assert len(held) == 8
    assert not np.isin(place[states(chosen)], place[held]).any()
    if isinstance(rule, str):
        assert chosen.held_out == choose_goals([scene], "all", hold_out=1 / 3, seed=2).held_out
        halves = choose_goals([scene], rule, hold_out=0.5, seed=1)
        assert sorted([*states(halves), *halves.held_out["grid"]]) == list(range(24))


def test_scenes_have_rules_of_their_own(scene):
    other = grid_scene(2, 1, name="closet", goals=(7,))
    chosen = choose_goals([scene, other], {"grid": "every:12"})
    assert make_world([scene, other], chosen.trained).goals.tolist() == [0, 12, 24 + 7]


def test_states_that_not_all_others_reach_are_no_goals():
    hall = grid_scene(width=4, depth=3, name="grid", goals=(5,), blocked=[(2, 0), (2, 1), (2, 2), (3, 2)])
    chosen = choose_goals([hall], "all")
    reached_from = (hall.distances >= 0).sum(0)
    assert reached_from.min() < reached_from.max()
    assert states(chosen).tolist() == np.flatnonzero(reached_from == reached_from.max()).tolist()
    assert chosen.left_out == {"grid": tuple(np.flatnonzero(reached_from < reached_from.max()).tolist())}


def with_a_sink(hall):
    """The same scene with a further place that its first state leads to, and that has no way back."""
    graph = np.concatenate(
        [hall.graph, len(hall) + np.array([[-1, 1, 3, -1], [-1, 2, 0, -1], [-1, 3, 1, -1], [-1, 0, 2, -1]])]
    )
    graph[len(hall) :, [0, 3]] = -1
    graph[0, 3] = len(hall)
    grown = {name: np.concatenate([getattr(hall, name), getattr(hall, name)[:4]]) for name in ("positions", "headings")}
    features = np.random.default_rng(1).random((len(graph), hall.features.shape[1]), np.float32)
    return replace(hall, graph=graph, features=features, **grown)


def test_a_place_that_one_cannot_leave_takes_no_goals_from_the_others():
    hall = with_a_sink(grid_scene(width=3, depth=2, name="grid", goals=(5,)))
    assert (hall.distances[24:, :24] < 0).all()
    chosen = choose_goals([hall], "all", hold_out=0.3, seed=1)
    assert not chosen.left_out
    assert len(chosen.held_out["grid"]) == 8  # two of seven places
    assert len(states(chosen)) == 28 - 8


@pytest.mark.parametrize(
    ("goals", "hold_out", "message"),
    [
        ("every:0", 0, "must be states"),
        ("fraction:0.75", 0.5, "more than all places"),
        ("every:24", 0.99, "leaves no goal"),
    ],
)
def test_rules_that_cannot_be_used_are_named(scene, goals, hold_out, message):
    refused(message, choose_goals, [scene], goals, hold_out=hold_out)
