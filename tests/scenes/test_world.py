"""Worlds: scenes joined into one state space, the goals in it, by rule or held out, and looks of its states."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from policies import run_episodes
from refusals import refused
from rooms import grid_scene
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import check_env_specs

from dirl.envs import NavigationEnv, SequentialViews, SurroundingViews
from dirl.evaluation.episodes import RandomPolicy, every_start
from dirl.scenes import make_world
from dirl.scenes.goals import choose_goals
from dirl.scenes.graph import AHEAD, BACK, places


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
    assert world.features.dtype == torch.float32
    assert world.distances.dtype == torch.int16


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


def test_what_makes_no_world_is_refused(scene):
    refused("^the scene 'grid' is named twice", make_world, [scene, hall(name="grid")])
    refused(r"has no features \(dataset resnet_feature\); encode its views", make_world, [hall(features=None)])
    told = "^hall and grid have features of different extractors.*: 'CLIP'"
    refused(told, make_world, [scene, hall(extractor="CLIP")])
    refused(r"^goals of several scenes are given by name, e.g. \{grid: \[0, 4\]\}", make_world, [scene, hall()], [0])
    refused(r"^grid: a goal is named twice in \[4, 0, 4\]", make_world, [scene], [4, 0, 4])


@pytest.fixture
def changing():
    return [grid_scene(width, 2, name=name, patches=True, looks=2) for width, name in ((3, "a"), (2, "b"))]


def test_the_view_id_of_a_look_is_the_look_times_the_states_and_the_state(changing):
    world = make_world(changing)
    assert (world.looks, len(world)) == (3, 40)
    for look in range(3):
        for scene, offset in zip(changing, world.offsets, strict=True):
            wanted = scene.features if look == 0 else scene.look_features[look - 1].astype(np.float32)
            rows = slice(look * 40 + offset, look * 40 + offset + len(scene))
            assert np.array_equal(world.features[rows].numpy(), wanted)
            parts = scene.patches if look == 0 else scene.look_patches[look - 1]
            assert np.array_equal(world.patches[rows].numpy(), parts)
    same = make_world([changing[0], grid_scene(2, 2, name="c", seed=2, patches=True)])  # of one look at every visit
    for look in range(3):
        assert np.array_equal(same.features[look * 40 + torch.arange(24, 40)].numpy(), same.scenes[1].features)
    others = [grid_scene(name="c", patches=True, looks=1), grid_scene(name="d", patches=True)]
    refused(r"different numbers of looks, \[1, 2, 3\]", make_world, [changing[0], *others])
    assert world.pictures(1).tolist() == [look * 40 + 24 + state for look in range(3) for state in range(16)]


@pytest.mark.parametrize("kind", [SurroundingViews, SequentialViews])
def test_every_visit_draws_a_look_that_its_four_views_share(changing, kind):
    world = make_world(changing)
    env = TransformedEnv(NavigationEnv(world, 50, seed=0), kind(world))
    check_env_specs(env)
    steps = env.rollout(6, break_when_any_done=False)
    looks = steps["look"]
    assert set(looks.unique().tolist()) == {0, 1, 2}
    ahead = looks * 40 + steps["state"]
    if kind is SurroundingViews:
        assert torch.equal(steps["view_ids"], world.surrounding[steps["state"]] + 40 * looks.unsqueeze(-1))
        assert torch.equal(steps["view_ids"][..., 0], ahead)
    else:
        assert torch.equal(steps["view_ids"][..., -1], ahead)
    assert torch.equal(steps["goal_view_ids"] // 40, steps["goal_look"].unsqueeze(-1).expand(-1, -1, 4))
    same = ~steps["next", "done"].squeeze(-1)[:, :-1]
    assert torch.equal(steps["goal_look"][:, 1:][same], steps["goal_look"][:, :-1][same])


@pytest.mark.parametrize(
    ("looks", "photos", "of_goals", "of_visits"),
    [(None, None, {0, 1, 2}, {0, 1, 2}), (range(2), range(2, 3), {2}, {0, 1})],
)
def test_goals_of_episodes_can_have_looks_of_their_own(changing, looks, photos, of_goals, of_visits):
    world, seen = make_world(changing), []

    def stop(wanted, ahead):
        seen.append((wanted // len(world.goals), ahead // len(world)))
        return torch.zeros_like(wanted, dtype=torch.bool)

    options = {"observation": SurroundingViews(world), "stop": stop, "max_steps": 8}
    run_episodes(RandomPolicy(), world, every_start(world), greedy=False, looks=looks, photos=photos, **options)
    goals, visits = (set(torch.cat(column).tolist()) for column in zip(*seen, strict=True))
    assert (goals, visits) == (of_goals, of_visits)


def states(chosen):
    """The trained goals of the one scene."""
    return np.array(chosen.trained["grid"])


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
    others = [grid_scene(2, 1, name=name, goals=(7,)) for name in ("closet", "hall")]
    chosen = choose_goals([scene, *others], {"grid": "every:10", "hall": "all"})
    assert make_world([scene, *others], chosen.trained).goals.tolist() == [0, 10, 20, 24 + 7, *range(32, 40)]


def test_states_that_not_all_others_reach_are_no_goals():
    divided = hall(name="grid")
    chosen = choose_goals([divided], "all")
    reached_from = (divided.distances >= 0).sum(0)
    assert reached_from.min() < reached_from.max()
    assert states(chosen).tolist() == np.flatnonzero(reached_from == reached_from.max()).tolist()
    assert chosen.left_out == {"grid": tuple(np.flatnonzero(reached_from < reached_from.max()).tolist())}


def test_a_place_that_one_cannot_leave_takes_no_goals_from_the_others(scene):
    graph = scene.graph.copy()
    graph[:4, [AHEAD, BACK]] = -1
    chosen = choose_goals([replace(scene, graph=graph)], "all", hold_out=0.3, seed=1)
    assert not chosen.left_out
    assert len(chosen.held_out["grid"]) == 8  # two of six places
    assert len(states(chosen)) == 24 - 8


def test_rules_that_cannot_be_used_are_named(scene):
    refused("must be states", choose_goals, [scene], "every:0")
    refused("more than all places", choose_goals, [scene], "fraction:0.75", hold_out=0.5)
    refused("leaves no goal", choose_goals, [scene], "every:24", hold_out=0.99)
