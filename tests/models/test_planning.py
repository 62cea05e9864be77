import itertools
import math

import pytest
import torch

from dirl.models import PlanningMemory
from dirl.models.planning import LAST, SURE

AHEAD, RIGHT, LEFT, BACK = range(4)
NOWHERE = torch.zeros(1, 4, dtype=torch.bool)
LIKES_ROOM = -torch.tensor(
    [[[4.0, 0.0, 0.0, 1.0], [3.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 4.0], [0.0, 0.0, 0.0, 3.0]]]
).log_softmax(-1)
"""Costs of one agent, facing each of four views: the first way is best, then the one on the right."""


def at(walked, node=None):
    """Whether each node looks like where the agent is."""
    return (torch.arange(walked.cost.shape[1]) == (-1 if node is None else node)).unsqueeze(0)


def walk(memory, *steps, likes=LIKES_ROOM, goal=NOWHERE, turns=4):
    """What one agent knows that sees its goal at first, and comes by actions to known nodes, or new places if None."""
    walked = memory.begin(torch.tensor([turns]))
    walked = memory.arrive(walked, at(walked), likes, goal)
    for action, node in steps:
        walked.action = torch.tensor([action])
        walked = memory.arrive(walked, at(walked, node), likes, NOWHERE)
    return walked


def cheapest(walked, memory, start, limit=7):
    """By trying all ways of up to ``limit`` actions: the cost of the best for each first action."""
    cost, after = walked.cost[0].tolist(), walked.after[0].tolist()
    found = [math.inf] * 4
    for way in itertools.product(range(4), repeat=limit):
        node, total = start, 0.0
        for action in way:
            total += cost[node][action]
            node = after[node][action]
            if node >= 0:
                total += memory.turn if action in (RIGHT, LEFT) else memory.repeated
            if node < 0:
                found[way[0]] = min(found[way[0]], total)
                break
    return found


def test_a_plan_is_the_cheapest_way_to_an_exit_not_tried():
    """At first, and after a way to a second place and a third, blocked there, turned, and back to the first."""
    memory = PlanningMemory(repeated=1.5, turn=0.2)
    way = (AHEAD, None), (RIGHT, 5), (AHEAD, None), (AHEAD, 12), (RIGHT, 13), (LEFT, 12), (BACK, 5)
    for steps, nodes in (((), (0, 1)), (way, (0, 3, 5, 6, 12))):
        walked = walk(memory, *steps)
        for node in nodes:
            walked.here = torch.tensor([node])
            costs = [-cost for cost in cheapest(walked, memory, node)]
            assert memory.plan(walked)[0].tolist() == pytest.approx(costs, abs=1e-5)


def test_a_blocked_way_is_not_tried_again_and_moves_count_in_both_directions():
    memory = PlanningMemory()
    walked = walk(memory, (AHEAD, 0))
    assert walked.after[0, 0, AHEAD] == 0
    assert walked.after[0, 2, BACK] == 2  # the same wall, behind who faces the other way
    assert memory.plan(walked)[0].argmax() != AHEAD
    walked = walk(memory, (AHEAD, None))
    assert walked.after[0, 0, AHEAD] == 4
    assert walked.after[0, 4, BACK] == 0
    assert walked.after[0, 2, BACK] == 6
    assert walked.after[0, 6, AHEAD] == 2


def test_a_goal_that_was_seen_is_walked_to_and_not_where_the_agent_did_not_stop():
    memory, seen = PlanningMemory(), torch.tensor([[True, False, True, False]])
    walked = walk(memory, goal=seen)
    assert walked.goal.tolist() == [[False, False, True, False]]
    plan = memory.plan(walked)[0]
    assert plan[[RIGHT, LEFT]].tolist() == [-2 * SURE, -2 * SURE]
    assert (plan[[AHEAD, BACK]] < -LAST).all()  # only if the goal could not be reached
    walked.action = torch.tensor([RIGHT])
    assert memory.arrive(walked, at(walked, 1), LIKES_ROOM, seen).goal.tolist() == [[False, False, True] + 5 * [False]]


def test_where_all_was_tried_the_policy_decides():
    memory = PlanningMemory()
    walked = walk(memory)
    walked.after[:] = torch.arange(4).view(1, 4, 1)
    walked.taken[:] = True
    assert torch.allclose(memory.plan(walked), -LIKES_ROOM[:, 0])


def test_what_was_done_is_no_guess_and_a_guess_is_tried_when_nothing_else_is_left():
    """Ahead leads from the first place to a second, back from there to a third, and ahead from that to the first."""
    memory = PlanningMemory()
    walked = walk(memory, (AHEAD, None))
    assert walked.after[0, 4, BACK] == 0  # a guess
    walked = walk(memory, (AHEAD, None), (BACK, None), (AHEAD, 0))
    assert walked.after[0, 4, BACK] == 8
    assert walked.after[0, 0, AHEAD] == 4  # as it was, though back from the first place is guessed to lead to the third
    assert walked.after[0, 0, BACK] == 8
    again = walk(memory, (AHEAD, None), (AHEAD, None), (BACK, 0))
    assert again.after[0, 0, AHEAD] == 4  # though back from the third place leads here
    walked.after[walked.after < 0] = 0  # all is known, or guessed
    assert memory.plan(walked)[0].max() < -LAST


def test_nothing_is_guessed_of_moves_that_no_arrow_shows():
    shown = LIKES_ROOM.clone()
    shown[:, :, BACK] = math.inf
    walked = walk(PlanningMemory(), (AHEAD, None), likes=shown)
    assert walked.after[0, 0, AHEAD] == 4
    assert walked.after[0, 4, BACK] == -1
    assert walked.after[0, 6, AHEAD] == 2


def test_smaller_turns_are_not_known_until_one_was_taken_and_then_they_are_from_all_four_views():
    """Turns of 45 degrees: right, back, and right twice, which leads to the next view of the first place."""
    assert (walk(PlanningMemory(), turns=8).after == -1).all()
    after = walk(PlanningMemory(), (RIGHT, None), (LEFT, 0), (RIGHT, 4), (RIGHT, 1), turns=8).after[0]
    assert after[:4, RIGHT].tolist() == [4, 5, 6, 7]
    assert after[4:8, LEFT].tolist() == [0, 1, 2, 3]
    assert after[4:8, RIGHT].tolist() == [1, 2, 3, 0]
    assert after[:4, LEFT].tolist() == [7, 4, 5, 6]
    assert (after[:, [AHEAD, BACK]] == -1).all()


def test_in_a_panorama_small_turns_are_known_and_so_is_the_goal_that_no_quarter_turn_faces():
    """Turns of 45 degrees: the goal is three views to the left, where the agent came from lies behind."""
    memory, views = PlanningMemory(), 8
    likes, nothing = LIKES_ROOM.repeat(1, 2, 1), torch.zeros(1, views, dtype=torch.bool)
    walked = memory.begin(torch.tensor([views]), views)
    walked = memory.arrive(walked, at(walked), likes, nothing)
    assert walked.after[0, :, RIGHT].tolist() == [1, 2, 3, 4, 5, 6, 7, 0]
    assert walked.after[0, :, LEFT].tolist() == [7, 0, 1, 2, 3, 4, 5, 6]
    walked.action = torch.tensor([AHEAD])
    walked = memory.arrive(walked, at(walked), likes, torch.arange(views).unsqueeze(0) == 5)
    assert walked.here.tolist() == [8]
    assert (walked.after[0, 0, AHEAD], walked.after[0, 8, BACK]) == (8, 0)
    assert (walked.after[0, 12, AHEAD], walked.after[0, 4, BACK]) == (4, 12)
    assert torch.allclose(memory.plan(walked)[0, [RIGHT, LEFT]], torch.tensor([-5 * SURE, -3 * SURE]))


@pytest.mark.parametrize(
    ("turns", "view", "action", "way"), [(8, 1, RIGHT, 1), (12, 3, LEFT, 1), (8, 2, RIGHT, 2), (12, 2, RIGHT, 2)]
)
def test_at_the_place_of_the_goal_an_agent_turns_until_it_faces_it_however_small_the_turns(turns, view, action, way):
    memory = PlanningMemory()
    walked = walk(memory, goal=torch.arange(4).unsqueeze(0) == view, turns=turns)
    for turn in range(1, way * turns // 4):
        assert memory.plan(walked)[0].argmax() == action
        walked.action = torch.tensor([action])
        further = turn % (turns // 4)  # of those between the first view and the second; they were seen before that
        known = None if turn < turns // 4 else (view // 2 if further == 0 else 4 * further + 1)
        walked = memory.arrive(walked, at(walked, known), LIKES_ROOM, NOWHERE)
    assert memory.plan(walked)[0].argmax() == action
