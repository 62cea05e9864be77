"""Live worlds: their moves, what goes wrong in them, and a navigator walked in them by its own code."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from field import Field

from dirl.evaluation.live_episodes import Remembered, evaluate_live
from dirl.scenes import load_scenes
from dirl.scenes.live import Dumped, Noisy, Pose, Simulated, repeats, state_pose


@pytest.fixture(scope="module")
def room():
    return load_scenes("bathroom_02")[0]


class Expert:
    """In the place of a navigator: it knows every view of a scene, and walks the shortest path."""

    def __init__(self, scene):
        self.scene = scene
        self.state_of = {scene.views[state].tobytes(): state for state in range(len(scene))}

    def reset(self, views):
        self.goal = self.state_of[views[0].tobytes()]

    def act(self, views):
        assert views.shape[0] == 4
        state = self.state_of[views[0].tobytes()]
        after = np.where(self.scene.graph[state] < 0, state, self.scene.graph[state])
        action = int(np.argmin(self.scene.distances[after, self.goal]))
        return SimpleNamespace(action=action, stop=state == self.goal)


def starts(room):
    return torch.tensor(room.goals[:2]).repeat_interleave(2), torch.tensor([0, 100, 20, 130])


def test_an_expert_takes_the_shortest_path_and_who_slips_a_longer_one(room):
    expert = Expert(room)
    found = evaluate_live(expert, Dumped(room), room, starts(room))
    assert found.success.all()
    assert found.steps.tolist() == found.shortest.tolist()
    assert not (found.false_stop | found.missed_stop).any()
    worlds = (Noisy(Dumped(room), slip=0.3, seed=seed) for seed in (1, 1, 2))
    first, again, other = (evaluate_live(expert, world, room, starts(room)) for world in worlds)
    assert first.success.all()
    assert (first.steps >= first.shortest).all()
    assert first.steps.sum() > 1.15 * first.shortest.sum()
    assert first.steps.tolist() == again.steps.tolist() != other.steps.tolist()


def test_a_world_repeats_itself_if_a_pose_shows_the_same_views_again(room):
    here = state_pose(room, 0)
    assert repeats(Dumped(room), here)
    views = iter(np.eye(2, dtype=np.uint8))
    assert not repeats(SimpleNamespace(reset=lambda pose: None, views=lambda: next(views)), here)


def test_a_live_agent_turns_by_as_much_as_it_errs_and_goes_where_it_looks():
    plane = Field(math.inf)
    world = Simulated(plane, step=2.0, turns=8)
    world.reset(Pose(1.0, 1.0, 0.0))
    world.step(1)
    assert np.allclose(world.pose, (1, 1, 45))
    world.step(0)
    assert np.allclose(world.pose, (3, 3, 45))  # to the next place askew
    world.step(1, error=-5.0)
    world.step(3)
    assert np.allclose(world.pose, (3 - 2 * np.sin(np.radians(85)), 3 - 2 * np.cos(np.radians(85)), 85))
    assert (world.views() == [plane.look(heading) for heading in (85, 175, 265, 355)]).all()
    thirty = Simulated(plane, step=2.0, turns=12)
    thirty.reset(Pose(0.0, 0.0, 30.0))
    assert not thirty.step(0)  # no place is there
    assert thirty.pose == (0, 0, 30)


def test_an_image_is_encoded_once():
    asked = []

    def encode(images):
        asked.append(len(images))
        return images.flatten(1).float()

    encoder = Remembered(encode)
    images = torch.arange(24, dtype=torch.uint8).reshape(4, 1, 2, 3)
    twice = images[[0, 1, 0]]
    assert (encoder(twice) == twice.flatten(1)).all()
    assert (encoder(images) == images.flatten(1)).all()
    assert asked == [2, 2]
