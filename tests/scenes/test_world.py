"""Worlds: scenes joined into one state space, and the goals in it."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from refusals import refused
from rooms import grid_scene

from dirl.scenes import make_world

TENSORS = dict.fromkeys(("graph", "surrounding", "scene_of", "goals", "row"), torch.int64)
TENSORS |= {"features": torch.float32, "distances": torch.int16}


def hall(**changes):
    """Eight places, two of them walled off from the others: 32 states."""
    made = grid_scene(width=4, depth=3, name="hall", goals=(5, 31), seed=1, blocked=[(2, 0), (2, 1), (2, 2), (3, 2)])
    return replace(made, **changes)


@pytest.fixture
def scenes(scene):
    return [scene, hall(), grid_scene(width=2, depth=1, name="closet", goals=(7,), headings=12)]


@pytest.fixture
def world(scenes):
    return make_world(scenes)


def test_scenes_lie_one_behind_the_other(world, scenes):
    assert len(world) == 24 + 32 + 24
    assert world.offsets == (0, 24, 56)
    assert world.scene_of.tolist() == [0] * 24 + [1] * 32 + [2] * 24
    assert world.names == ("grid", "hall", "closet")
    expected = [scene.surrounding + offset for scene, offset in zip(scenes, world.offsets, strict=True)]
    assert world.surrounding.tolist() == np.concatenate(expected).tolist()


def test_panoramas_are_the_states_after_each_turn_right_if_all_scenes_have_as_many(world):
    quarters = make_world([hall()])
    assert torch.equal(quarters.panoramas(), quarters.surrounding)
    eighths = make_world([grid_scene(2, 2, name="eighths", headings=8)])
    assert eighths.panoramas()[9].tolist() == [9, 10, 11, 12, 13, 14, 15, 8]
    assert torch.equal(eighths.panoramas()[:, ::2], eighths.surrounding)
    refused(r"^panoramas of \[4, 12\] views: scenes have turns of several angles; take", world.panoramas)


def test_the_scenes_of_a_world_share_its_features_which_are_float32(scenes):
    halves = replace(scenes[0], features=scenes[0].features.astype(np.float16))
    world = make_world([halves, *scenes[1:]])
    for scene, given in zip(world.scenes, [halves, *scenes[1:]], strict=True):
        assert np.shares_memory(scene.features, world.features.numpy())
        assert (scene.features == given.features).all()
        assert not scene.features.flags.writeable
    assert not np.shares_memory(scenes[1].features, world.features.numpy())
    for name, kind in TENSORS.items():
        assert getattr(world, name).dtype == kind, name
    assert world.distance(torch.tensor(0), torch.tensor(0)).dtype == torch.int64


def test_the_distance_of_each_pair_is_that_of_a_search_in_its_scene(world, scenes):
    assert world.goals.tolist() == [0, 24 + 5, 24 + 31, 56 + 7]
    for index, (scene, goal) in enumerate([(0, 0), (1, 5), (1, 31), (2, 7)]):
        expected = scenes[scene].distances[:, goal].tolist()
        states = torch.arange(len(scenes[scene])) + world.offsets[scene]
        goal_index = torch.full_like(states, index)
        assert world.distance(goal_index, states).tolist() == expected
        assert world.distance(torch.tensor(index), states[:6].view(2, 3)).tolist() == [expected[:3], expected[3:6]]
        assert world.distances[world.pair(goal_index, states)].tolist() == expected
        assert world.block(world.distances, index).tolist() == expected


def test_goals_replace_those_of_the_scenes_that_they_name(scene, scenes):
    for goals in ([3, 0], (3, 0), {"grid": [3, 0]}):
        world = make_world([scene], goals)
        assert world.goals.tolist() == [3, 0]
        assert world.distances.tolist() == [*scene.distances[:, 3].tolist(), *scene.distances[:, 0].tolist()]
    assert make_world([scene], {"grid": 5}).goals.tolist() == make_world([scene], 5).goals.tolist() == [5]
    assert make_world(scenes, {"closet": [1], "grid": [2]}).goals.tolist() == [2, 29, 55, 57]


@pytest.mark.parametrize(
    ("scenes", "goals", "message"),
    [
        ([grid_scene(), hall(name="grid")], None, "the scene 'grid' is named twice"),
        ([hall(features=None)], None, r"grid_scene: has no features \(dataset resnet_feature\); encode its views"),
        (
            [grid_scene(), hall(extractor="CLIP")],
            None,
            "hall and grid have features of different extractors.*: 'CLIP' ",
        ),
        ([grid_scene(), hall()], [0], r"goals of several scenes are given by name, e.g. \{grid: \[0, 4\]\}"),
        ([grid_scene()], [4, 0, 4], r"grid: a goal is named twice in \[4, 0, 4\]"),
    ],
)
def test_what_makes_no_world_is_refused(scenes, goals, message):
    refused(f"^{message}", make_world, scenes, goals)
