import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from rooms import grid_scene

from dirl.perception.recognition.recogniser import TemplateStop, ncc
from dirl.scenes import make_world

NUMBER = st.floats(-5, 5, allow_nan=False, width=32)
VECTOR = st.lists(NUMBER, min_size=6, max_size=6).filter(lambda values: np.std(values) > 0.01)


@pytest.fixture
def world():
    """Two rooms of 8 states each, goals 1 and 8 + 6."""
    return make_world([grid_scene(2, 1, name=name, goals=(goal,), seed=goal) for name, goal in (("a", 1), ("b", 6))])


@given(VECTOR, VECTOR)
def test_ncc_is_pearsons_coefficient(a, b):
    found = ncc(torch.tensor(a, dtype=torch.float64), torch.tensor(b, dtype=torch.float64))
    assert found.item() == pytest.approx(np.corrcoef(a, b)[0, 1], abs=1e-9)


def test_ncc_with_a_constant_vector_is_zero():
    # In float32 the mean of such a vector is not quite its value, and what remains is taken for a pattern.
    constant = torch.full((2048,), 0.1)
    assert ncc(constant, torch.randn(2048)) == 0
    assert ncc(constant, constant) == 0


@pytest.mark.parametrize("match", ["views", "front"])
def test_scores_are_the_coefficients_of_every_goal_with_every_state(match, world):
    scores = TemplateStop(match=match).scores(world)
    assert scores.shape == (2 * 8,)
    for index, goal in enumerate(world.goals.tolist()):
        for state in range(8 * index, 8 * index + 8):
            # Of a state in a grid the views are its own and those of the next headings of its place.
            place, heading = divmod(state, 4)
            goal_place, goal_heading = divmod(goal, 4)
            turns = range(4) if match == "views" else range(1)
            here = torch.cat([world.features[4 * place + (heading + turn) % 4] for turn in turns])
            there = torch.cat([world.features[4 * goal_place + (goal_heading + turn) % 4] for turn in turns])
            score = scores[world.pair(torch.tensor(index), torch.tensor(state))]
            assert score.item() == pytest.approx(np.corrcoef(here, there)[0, 1], abs=1e-5)


def test_nobody_stops_in_another_scene_or_where_the_goal_is_out_of_reach():
    # Both scenes look the same everywhere, and so do the places that a wall cuts off.
    rooms = [grid_scene(3, 1, name=name, goals=(1,), blocked=[(1, 0)]) for name in ("a", "b")]
    world = make_world(rooms)
    world.features[:] = torch.rand(16)
    stops = torch.stack(world.pairs(), 1)[TemplateStop()(world)].tolist()
    assert stops == [[0, state] for state in range(4)] + [[1, 8 + state] for state in range(4)]


def test_a_state_stops_only_above_the_threshold(world):
    scores = world.block(TemplateStop().scores(world), 0)
    threshold = scores.sort().values[-3].item()
    stop = world.block(TemplateStop(threshold)(world), 0)
    assert stop.sum() == 2
    assert torch.equal(stop, scores > threshold)
