import pytest
import torch
from tensordict import TensorDict

from dirl.envs import SurroundingViews
from dirl.evaluation.episodes import RandomPolicy
from dirl.evaluation.experts import (
    ShortestPathExpert,
    ShortestPathPolicy,
    demonstrations,
    label,
    merge_demonstrations,
    shown_states,
)

AHEAD, RIGHT, LEFT, BACK = range(4)


def expert_action(world, goal_index, state):
    asked = TensorDict({"state": state, "goal": world.goals[goal_index]}, [len(state)])
    return ShortestPathExpert(world)(asked)["expert_action"]


def test_optimal_actions_are_all_that_come_nearer_and_the_expert_takes_the_first(world):
    goal_index, state = (part[world.distances > 0] for part in world.pairs())
    after = world.distance(goal_index.unsqueeze(1), world.graph[state])
    nearer = after < world.distance(goal_index, state).unsqueeze(1)
    asked = TensorDict({"state": state, "goal": world.goals[goal_index]}, [len(state)])
    assert torch.equal(ShortestPathExpert(world)(asked)["optimal_actions"], nearer)
    assert torch.equal(expert_action(world, goal_index, state), nearer.int().argmax(1))


def test_random_states_are_a_fraction_and_depend_on_the_seed(world):
    chosen = [shown_states(world, 0.25, "random", seed) for seed in (0, 0, 1)]
    assert [int(one.sum()) for one in chosen] == [6 + 3 + 2] * 3
    assert torch.equal(chosen[0], chosen[1])
    assert not torch.equal(chosen[0], chosen[2])


@pytest.mark.parametrize(
    ("fraction", "rule", "states"),
    [
        # Counted from each scene's own first state, place 0 of the room, the corner and the split room.
        (0.1, "interval", [0, 10, 20, 24, 34, 36]),
        (0.25, "interval_pos", [0, 1, 2, 3, 16, 17, 18, 19, 24, 25, 26, 27, 36, 37, 38, 39]),
    ],
)
def test_states_are_counted_scene_by_scene(world, fraction, rule, states):
    reaching_another = set(states) - {37}
    shows = demonstrations(world, ShortestPathExpert(world), SurroundingViews(world), fraction, rule)
    assert set(shows["state"].tolist()) == reaching_another
    assert torch.equal(shows["scene"], world.scene_of[shows["state"]])


def test_without_a_way_or_at_the_goal_the_expert_has_no_advice_and_its_policy_no_preference(world):
    # At the goals, and of state 41, which a wall separates from goal 37.
    goal_index, state = torch.tensor([0, 2, 3, 3, 0]), torch.tensor([0, 30, 37, 41, 3])
    asked = TensorDict({"state": state, "goal": world.goals[goal_index]}, [5])
    assert expert_action(world, goal_index, state).tolist() == [-1] * 4 + [RIGHT]
    probabilities = ShortestPathPolicy(world)(asked)["logits"].softmax(-1)
    assert probabilities.tolist() == [[0.25] * 4] * 4 + [[0, 1, 0, 0]]
    assert RandomPolicy()(asked)["logits"].softmax(-1).tolist() == [[0.25] * 4] * 5


def visited(world, goal_index, state):
    goal, state, observation = world.goals[torch.tensor(goal_index)], torch.tensor(state), SurroundingViews(world)
    rows = {"state": state, "goal": goal, "scene": world.scene_of[goal]}
    rows |= {"view_ids": observation.reset_view_ids(state), "goal_view_ids": observation.reset_view_ids(goal)}
    return TensorDict(rows, [len(state)])


def test_merged_demonstrations_keep_the_first_of_each_that_observe_the_same(world):
    first = label(ShortestPathExpert(world), visited(world, [0, 0, 1], [3, 5, 3]))
    again = label(ShortestPathExpert(world), visited(world, [1, 0, 0], [3, 5, 7]))
    again["expert_action"][:] = 9
    merged = merge_demonstrations(first, again)
    rows = {(row["goal"].item(), row["state"].item()): row["expert_action"].item() for row in merged}
    assert len(merged) == len(rows) == 4
    assert rows[0, 7] == 9
    assert 9 not in (rows[0, 3], rows[0, 5], rows[13, 3])
    assert len(merge_demonstrations(merged, merged)) == 4
