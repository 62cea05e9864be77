from collections import Counter

import pytest
import torch
from rooms import grid_scene

from dirl.envs import SurroundingViews
from dirl.evaluation.experts import ShortestPathExpert, label
from dirl.scenes import make_world
from dirl.training.pairs import DrawnPairs, with_labels


def pairs(world, **options):
    shown = options.pop("shown", torch.ones(len(world), dtype=torch.bool))
    observation = SurroundingViews(world, options.pop("goal_view", "surrounding"))
    return DrawnPairs(world, ShortestPathExpert(world), observation, shown, **options)


def test_pairs_are_drawn_by_goal_and_then_among_the_states_of_its_scene(world):
    torch.manual_seed(0)
    drawn = pairs(world).draw(60_000)
    counts = Counter(zip(drawn["goal"].tolist(), drawn["state"].tolist(), strict=True))
    wanted = {(goal, state) for goal in (0, 13) for state in range(24)} | {(33, state) for state in range(24, 40)}
    assert set(counts) == wanted - {(0, 0), (13, 13), (33, 33)}
    assert sum(count for (goal, _), count in counts.items() if goal == 33) == pytest.approx(20_000 * 15 / 16, rel=0.03)
    assert max(counts.values()) < 2 * min(counts[pair] for pair in counts if pair[0] == 33)
    assert torch.equal(drawn["scene"], world.scene_of[drawn["state"]])
    assert torch.equal(drawn["view_ids"], world.surrounding[drawn["state"]])


def test_a_share_of_the_goals_is_shown_by_its_front_view(world):
    drawn = pairs(world, front_only=0.3).draw(5000)
    photo = drawn["goal_view_ids"][:, 1] == len(world)
    assert photo.float().mean() == pytest.approx(0.3, abs=0.03)
    assert torch.equal(drawn["goal_view_ids"][:, 0], drawn["goal"])
    assert (drawn["goal_view_ids"][photo, 1:] == len(world)).all()
    assert torch.equal(drawn["goal_view_ids"][~photo], world.surrounding[drawn["goal"][~photo]])


def test_in_a_world_that_changes_goal_and_state_are_seen_in_two_looks():
    world = make_world([grid_scene(goals=(0, 13), looks=2)])
    states = len(world)
    drawn = pairs(world, front_only=0.5).draw(2000)
    look, goal_look = drawn["view_ids"][:, 0] // states, drawn["goal_view_ids"][:, 0] // states
    assert (look != goal_look).all()
    assert Counter(look.tolist()).keys() == Counter(goal_look.tolist()).keys() == {0, 1, 2}
    assert torch.equal(drawn["view_ids"], world.surrounding[drawn["state"]] + look.unsqueeze(1) * states)
    photo = drawn["goal_view_ids"][:, 1] == 3 * states
    assert photo.float().mean() == pytest.approx(0.5, abs=0.05)


def test_half_of_a_draw_are_states_that_the_learner_came_to(world):
    table = pairs(world)
    visited = label(table.expert, table.draw(3))
    merged = with_labels(with_labels(table, visited[:1]), visited[1:])
    drawn = merged.draw(4000)
    keys = set(zip(visited["state"].tolist(), visited["goal"].tolist(), strict=True))
    found = [pair in keys for pair in zip(drawn["state"].tolist(), drawn["goal"].tolist(), strict=True)]
    assert sum(found[-2000:]) == 2000
    assert sum(found[:1900]) < 1000
