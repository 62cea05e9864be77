from collections import deque

import pytest
import torch
from rooms import grid_scene

from dirl.experts import RULES, demonstration_states, demonstrations, expert_action, optimal_actions
from dirl.scenes import make_world

AHEAD, RIGHT, LEFT, BACK = range(4)


@pytest.fixture
def world():
    """24 states with goals 0 and 13, 12 around a corner with goal 30, 8 in two unconnected places with goal 37."""
    room = grid_scene(3, 2, name="room", goals=(0, 13))
    corner = grid_scene(2, 2, name="corner", goals=(6,), blocked=[(1, 1)])
    split = grid_scene(3, 1, name="split", goals=(1,), blocked=[(1, 0)])
    return make_world([room, corner, split])


def distances_by_hand(world, goal):
    """Fewest actions from each state that reaches the goal, by a search of its own."""
    distances, queue = {goal: 0}, deque([goal])
    while queue:
        state = queue.popleft()
        for before in (world.graph == state).any(1).nonzero().flatten().tolist():
            if before not in distances:
                distances[before] = distances[state] + 1
                queue.append(before)
    return distances


def every_case(world):
    """Goal index, state and distances of every state that reaches a goal."""
    for index, goal in enumerate(world.goals.tolist()):
        distances = distances_by_hand(world, goal)
        for state in set(distances) - {goal}:
            yield index, state, distances


def test_the_expert_always_comes_one_step_nearer(world):
    cases = list(every_case(world))
    assert len(cases) == 23 + 23 + 11 + 3
    actions = expert_action(world, torch.tensor([c[0] for c in cases]), torch.tensor([c[1] for c in cases]))
    for (_, state, distances), action in zip(cases, actions, strict=True):
        assert distances[world.graph[state, action].item()] == distances[state] - 1


def test_optimal_actions_are_all_that_come_nearer_and_the_expert_takes_the_first(world):
    for index, state, distances in every_case(world):
        nearer = [distances[next_state] < distances[state] for next_state in world.graph[state].tolist()]
        case = torch.tensor([index]), torch.tensor([state])
        assert optimal_actions(world, *case).tolist() == [nearer]
        assert expert_action(world, *case).tolist() == [nearer.index(True)]


@pytest.mark.parametrize(
    ("state", "optimal", "chosen"),
    [
        pytest.param(2, [RIGHT, LEFT], RIGHT, id="either turn"),
        pytest.param(14, [AHEAD, RIGHT, LEFT], AHEAD, id="turn before or after the step"),
        pytest.param(13, [LEFT], LEFT, id="the nearer turn"),
        pytest.param(12, [BACK], BACK, id="one way only"),
    ],
)
def test_of_several_optimal_actions_the_first_is_taken(world, state, optimal, chosen):
    case = torch.tensor([0]), torch.tensor([state])
    assert optimal_actions(world, *case)[0].nonzero().flatten().tolist() == optimal
    assert expert_action(world, *case).tolist() == [chosen]


PLACE = torch.tensor([0, 0, 1, 1, 2, 0, 2, 3, 1, 3, 4, 4])


def shown(share, rule, place=PLACE, seed=0):
    chosen = demonstration_states(place, share, rule, torch.Generator().manual_seed(seed))
    assert chosen.dtype == torch.bool
    assert len(chosen) == len(place)
    return chosen.nonzero().flatten().tolist()


@pytest.mark.parametrize(("share", "every"), [(0.5, 2), (0.25, 4), (0.2, 5), (0.3, 3), (0.05, 20)])
def test_interval_shows_every_kth_state(share, every):
    assert shown(share, "interval") == list(range(0, 12, every))


@pytest.mark.parametrize(("share", "states"), [(0.5, [0, 1, 4, 5, 6, 10, 11]), (0.25, [0, 1, 5, 10, 11])])
def test_interval_pos_shows_every_kth_place_with_all_its_headings(share, states):
    assert shown(share, "interval_pos") == states


@pytest.mark.parametrize(("share", "states"), [(0.5, 50), (0.05, 5), (0.128, 13), (0.001, 1)])
def test_random_shows_the_share_of_states_and_at_least_one(share, states):
    place = torch.arange(100)
    first = shown(share, "random", place)
    assert len(first) == states
    assert shown(share, "random", place) == first
    assert shown(share, "random", place, seed=1) != first


@pytest.mark.parametrize("rule", RULES)
def test_nothing_and_everything_are_shares_too(rule):
    assert shown(0, rule) == []
    assert shown(1, rule) == list(range(12))


@pytest.mark.parametrize("share", [-0.1, 1.01, float("nan")])
def test_a_share_beyond_nothing_and_everything_is_refused(world, share):
    with pytest.raises(ValueError, match="between 0 and 1"):
        demonstrations(world, share)


@pytest.mark.parametrize("share", [0, 0.1])
def test_an_unknown_rule_is_refused_with_the_choices(world, share):
    with pytest.raises(ValueError, match=r"no rule 'intervall'.*'interval_pos'"):
        demonstrations(world, share, "intervall")


def test_everything_is_shown_for_every_goal_but_the_goal_and_what_does_not_reach_it(world):
    shows = demonstrations(world, 1)
    rows = list(zip(shows["goal"].tolist(), shows["state"].tolist(), strict=True))
    wanted = [(world.goals[index].item(), state) for index, state, _ in every_case(world)]
    assert sorted(rows) == sorted(wanted)
    assert shows.batch_size == (60,)


def test_a_demonstration_holds_the_experts_action_and_the_scene(world):
    shows = demonstrations(world, 1)
    assert {key: value.dtype for key, value in shows.items()} == dict.fromkeys(
        ("state", "goal", "scene", "expert_action"), torch.int64
    )
    goal_index = torch.tensor([world.goals.tolist().index(goal) for goal in shows["goal"].tolist()])
    assert torch.equal(shows["expert_action"], expert_action(world, goal_index, shows["state"]))
    assert torch.equal(shows["scene"], world.scene_of[shows["state"]])
    assert torch.equal(shows["scene"], world.scene_of[shows["goal"]])


@pytest.mark.parametrize(
    ("share", "rule", "states"),
    [
        # Counted from each scene's own first state, place 0 of the room, the corner and the split room.
        (0.1, "interval", [0, 10, 20, 24, 34, 36]),
        (0.25, "interval_pos", [0, 1, 2, 3, 16, 17, 18, 19, 24, 25, 26, 27, 36, 37, 38, 39]),
    ],
)
def test_states_are_counted_scene_by_scene(world, share, rule, states):
    reaching_another = set(states) - {37}
    assert set(demonstrations(world, share, rule)["state"].tolist()) == reaching_another


def test_randomly_chosen_states_are_decided_by_the_seed_and_the_same_for_every_goal(world):
    first, again, other = (demonstrations(world, 0.25, "random", seed)["state"] for seed in (4, 4, 5))
    assert torch.equal(first, again)
    assert set(first.tolist()) != set(other.tolist())
    # A quarter of the first scene's 24 states, each for its two goals unless it is one of them.
    in_room = first[first < 24].tolist()
    assert len(set(in_room)) == 6
    assert all(in_room.count(state) == 2 - (state in (0, 13)) for state in in_room)


def test_no_share_gives_no_demonstrations(world):
    assert demonstrations(world, 0).batch_size == (0,)
