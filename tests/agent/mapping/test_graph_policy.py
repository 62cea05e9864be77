"""Navigation by a topological map as a policy: evaluated like any other, from every start to every goal."""

import pytest
import torch
from policies import RIGHT, always, run_episodes
from rooms import grid_scene

from dirl.agent.mapping import GraphMemory, GuidedPolicy
from dirl.envs import SurroundingViews
from dirl.evaluation.episodes import every_start
from dirl.evaluation.protocol import metrics
from dirl.scenes import make_world


@pytest.fixture(scope="module")
def world():
    rooms = [
        grid_scene(4, 3, name="a", blocked=[(1, 1)], feature_width=64, goals=(0, 21, 42), seed=0),
        grid_scene(3, 3, name="b", headings=8, feature_width=64, goals=(5, 50), seed=1),
    ]
    return make_world(rooms)


def walked(policy, world, view="surrounding", **options):
    observation = SurroundingViews(world, view)
    return run_episodes(policy, world, every_start(world), observation=observation, max_steps=60, **options)


@pytest.mark.parametrize(("view", "greedy"), [("surrounding", True), ("front", True), ("surrounding", False)])
def test_after_one_walk_it_goes_anywhere_also_by_drawn_actions(world, view, greedy):
    found = metrics(walked(GraphMemory(world), world, view, greedy=greedy))
    assert found["sr"] == 1
    assert found["spl"] > 0.98


def test_it_goes_to_what_it_is_shown(world):
    """Shown another goal it goes there, and misses its own."""
    other = torch.tensor([1, 2, 0, 4, 3])
    assert metrics(walked(GraphMemory(world), world, shown=other))["sr"] < 0.6


def test_a_short_walk_is_worse(world):
    whole = metrics(walked(GraphMemory(world), world))["spl"]
    assert metrics(walked(GraphMemory(world, steps_per_state=0.2), world))["spl"] < whole - 0.2


def test_the_last_steps_are_the_policys(world):
    memory = GraphMemory(world)
    led = walked(GuidedPolicy(always(RIGHT), memory, last_steps=0), world)
    assert metrics(led)["sr"] == 1
    near = walked(GuidedPolicy(always(RIGHT), memory, last_steps=2), world)
    alone = walked(always(RIGHT), world)
    assert metrics(alone)["sr"] < metrics(near)["sr"] < 1
