"""Scenes whose states have several looks: in memory, in files, in worlds, in the environment."""

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


@pytest.fixture
def scenes():
    return [
        grid_scene(3, 2, name="a", patches=True, looks=2),
        grid_scene(2, 2, name="b", seed=1, patches=True, looks=2),
    ]


def test_the_view_id_of_a_look_is_the_look_times_the_states_and_the_state(scenes):
    world = make_world(scenes)
    assert (world.looks, len(world)) == (3, 40)
    for look in range(3):
        for scene, offset in zip(scenes, world.offsets, strict=True):
            wanted = scene.features if look == 0 else scene.look_features[look - 1].astype(np.float32)
            rows = slice(look * 40 + offset, look * 40 + offset + len(scene))
            assert np.array_equal(world.features[rows].numpy(), wanted)
            parts = scene.patches if look == 0 else scene.look_patches[look - 1]
            assert np.array_equal(world.patches[rows].numpy(), parts)
    same = make_world([scenes[0], grid_scene(2, 2, name="c", seed=2, patches=True)])  # of one look at every visit
    for look in range(3):
        assert np.array_equal(same.features[look * 40 + torch.arange(24, 40)].numpy(), same.scenes[1].features)
    others = [grid_scene(name="c", patches=True, looks=1), grid_scene(name="d", patches=True)]
    refused(r"different numbers of looks, \[1, 2, 3\]", make_world, [scenes[0], *others])
    assert world.pictures(1).tolist() == [look * 40 + 24 + state for look in range(3) for state in range(16)]


@pytest.mark.parametrize("kind", [SurroundingViews, SequentialViews])
def test_every_visit_draws_a_look_that_its_four_views_share(scenes, kind):
    world = make_world(scenes)
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
def test_goals_of_episodes_can_have_looks_of_their_own(scenes, looks, photos, of_goals, of_visits):
    world, seen = make_world(scenes), []

    def stop(wanted, ahead):
        seen.append((wanted // len(world.goals), ahead // len(world)))
        return torch.zeros_like(wanted, dtype=torch.bool)

    options = {"observation": SurroundingViews(world), "stop": stop, "max_steps": 8}
    run_episodes(RandomPolicy(), world, every_start(world), greedy=False, looks=looks, photos=photos, **options)
    goals, visits = (set(torch.cat(column).tolist()) for column in zip(*seen, strict=True))
    assert (goals, visits) == (of_goals, of_visits)
