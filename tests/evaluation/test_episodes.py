import json
import math
from dataclasses import replace
from itertools import pairwise, permutations

import pytest
import torch
from networks import make_policy
from policies import COUNTED, Asked, always, expert, outcome, run_episodes
from rooms import grid_scene
from tensordict import TensorDict
from torchrl.envs import TransformedEnv

from dirl.envs import NavigationEnv, SequentialViews, SurroundingViews
from dirl.evaluation import episodes as episodes_module
from dirl.evaluation.episodes import RandomPolicy, drawn_looks, every_start, sampled_starts, shortest_episodes
from dirl.evaluation.experts import (
    ShortestPathExpert,
    ShortestPathPolicy,
    demonstrations,
    label,
    merge_demonstrations,
    shown_states,
)
from dirl.evaluation.protocol import (
    WINDOW,
    EpisodeMeter,
    EvaluationProtocol,
    assess,
    metrics,
    other_goals,
    report,
)
from dirl.models import PlanningMemory, initial_state, recurrent_keys
from dirl.scenes import make_world

RIGHT = 1


@pytest.fixture
def world():
    """24 states with goals 0 and 13, 12 around a corner with goal 30, 8 in two unconnected places with goal 37."""
    room = grid_scene(3, 2, name="room", goals=(0, 13))
    corner = grid_scene(2, 2, name="corner", goals=(6,), blocked=[(1, 1)], seed=1)
    split = grid_scene(3, 1, name="split", goals=(1,), blocked=[(1, 0)], seed=2)
    return make_world([room, corner, split])


def test_sampled_starts_are_as_many_for_each_goal_and_uniform_among_those_that_reach_it(world):
    goal_index, start = sampled_starts(world, 6000, seed=1)
    assert goal_index.bincount().tolist() == [6000] * 4
    assert torch.equal(torch.stack([goal_index, start]).unique(dim=1), torch.stack(every_start(world)))
    assert start[-6000:].bincount()[[36, 38, 39]].tolist() == pytest.approx([2000] * 3, abs=200)
    assert torch.equal(start, sampled_starts(world, 6000, seed=1)[1])
    assert not torch.equal(start, sampled_starts(world, 6000, seed=2)[1])


def test_the_look_of_the_goal_is_not_that_of_a_visit():
    world = make_world([grid_scene(looks=2)])
    besides = torch.arange(300) % 3
    state = torch.full((300,), 7)
    drawn = drawn_looks(state, len(world), world, torch.Generator().manual_seed(0), besides)
    assert (drawn % len(world) == 7).all()
    assert {*zip((drawn // len(world)).tolist(), besides.tolist(), strict=True)} == {*permutations(range(3), 2)}


@pytest.mark.parametrize(("kind", "greedy"), [(SurroundingViews, True), (SequentialViews, False)])
def test_the_expert_takes_a_shortest_path_from_everywhere(world, kind, greedy):
    episodes = run_episodes(expert(world), world, every_start(world), observation=kind(world), greedy=greedy)
    assert torch.equal(episodes.steps, episodes.shortest)
    known = shortest_episodes(world, every_start(world))
    assert all(torch.equal(value, vars(known)[name]) for name, value in vars(episodes).items())
    found = metrics(episodes)
    assert (found["sr"], found["spl"]) == (1, 1)
    assert found["atl"] == found["atl_success"] == found["shortest"]
    assert (found["false_stop_rate"], found["missed_stop_rate"]) == (0, 0)
    assert found["episodes"] == 23 + 23 + 11 + 3


def test_failures_count_as_the_limit_in_a_report_of_each_scene_and_each_goal_by_its_number_in_the_scene(world):
    # Who only turns right comes from 3 to goal 0 in one step, from 2 in two, from 1 in three, else never.
    episodes = run_episodes(always(RIGHT), world, every_start(world), observation=SurroundingViews(world), max_steps=10)
    assert episodes.steps[:23].tolist() == [3, 2, 1] + [10] * 20
    assert episodes.success[:23].tolist() == [True] * 3 + [False] * 20
    summary = report(episodes, world)
    goals = {name: list(scene["goals"]) for name, scene in summary["scenes"].items()}
    assert goals == {"room": ["0", "13"], "corner": ["6"], "split": ["1"]}
    found = summary["scenes"]["room"]["goals"]["0"]
    assert (found["sr"], found["episodes"]) == (pytest.approx(3 / 23), 23)
    assert found["atl"] == pytest.approx((1 + 2 + 3 + 20 * 10) / 23)
    assert found["atl_success"] == 2
    # From 1 a left turn would have done.
    assert found["spl"] == pytest.approx((1 / 1 + 2 / 2 + 1 / 3) / 23)
    # Three starts each are at the goal's own place.
    assert summary["scenes"]["room"]["sr"] == pytest.approx(6 / 46)
    assert summary["scenes"]["room"]["goals"]["13"]["sr"] == pytest.approx(3 / 23)
    assert summary["scenes"]["corner"]["goals"]["6"]["sr"] == pytest.approx(3 / 11)
    assert summary["scenes"]["split"]["sr"] == 1
    json.dumps(summary)


def test_sampled_actions_follow_the_policys_probabilities(world):
    # One step from 3: the goal by a right turn only.
    logits = torch.tensor([0.2, 0.5, 0.2, 0.1]).log()
    starts, observation = (torch.zeros(20_000, dtype=torch.int64), torch.full((20_000,), 3)), SurroundingViews(world)
    for policy, share in ((Asked(lambda rows: logits.expand(len(rows), 4)), 0.5), (RandomPolicy(), 0.25)):
        episodes = run_episodes(policy, world, starts, observation=observation, max_steps=1, greedy=False)
        assert metrics(episodes)["sr"] == pytest.approx(share, abs=0.02)


def by_the_env(policy, world, starts, observation, stop, max_steps):
    """The greedy outcome of each episode, walked in the training environment, every agent asked at every step."""
    goal_index, start = starts
    env = TransformedEnv(NavigationEnv(world, len(start), stop=stop), observation)
    agents, memory = env.reset(), initial_state(policy, len(start), world.device)
    agents["is_init"] = torch.ones(len(start), 1, dtype=torch.bool)
    agents["state"], agents["goal"], agents["scene"] = start, world.goals[goal_index], world.scene_of[start]
    agents["view_ids"] = observation.reset_view_ids(start)
    agents["goal_view_ids"] = observation.reset_view_ids(world.goals[goal_index])
    going = torch.ones_like(start, dtype=torch.bool)
    found = {key: torch.zeros_like(going) for key in ("success", "false_stop", "missed_stop")}
    found["steps"] = torch.full_like(start, max_steps)
    for step in range(1, max_steps + 1):
        answered = policy(agents.copy().update(memory))
        memory = {key: answered["next", key] for key in memory}
        agents["action"] = answered["logits"].argmax(-1)
        after = env.step(agents)["next"]
        ended = going & after["terminated"].squeeze(-1)
        at_goal = after["state"] == after["goal"]
        found["success"] |= ended & at_goal
        found["false_stop"] |= ended & ~at_goal
        found["missed_stop"] |= going & at_goal & ~ended
        found["steps"][ended & at_goal] = step
        going &= ~ended
        agents = env.step_mdp(agents)
        agents["is_init"] = torch.zeros(len(start), 1, dtype=torch.bool)
    return {key: found[key].tolist() for key in COUNTED}


class Advised(torch.nn.Module):
    """A random network's preferences, and the expert's now and then, so that some arrive and some do not."""

    def __init__(self, world, network):
        super().__init__()
        self.network, self.expert, self.out_keys = network, expert(world, sureness=0.1), network.out_keys

    @torch.no_grad()
    def forward(self, rows):
        own = self.network(rows)["logits"]
        return rows.set("logits", own + self.expert(rows.copy())["logits"])


@pytest.mark.parametrize("kind", [SurroundingViews, SequentialViews])
@pytest.mark.parametrize(("seed", "memory"), [(0, False), (1, True)])
def test_episodes_are_those_of_the_environment_walked_step_by_step(world, kind, seed, memory):
    policy = Advised(world, make_policy(world.features, world.names, width=16, seed=seed, memory=memory))
    assert len(recurrent_keys(policy)) == memory
    stop = (world.distances == 0) & (world.pairs()[0] != 1)
    stop |= (torch.rand(stop.shape, generator=torch.Generator().manual_seed(seed)) < 0.05) & (world.distances >= 0)
    starts = every_start(world)
    episodes = run_episodes(policy, world, starts, observation=kind(world), stop=stop, max_steps=30)
    found = outcome(episodes)
    assert found == by_the_env(policy, world, starts, kind(world), stop, 30)
    rates = metrics(episodes)
    for key, rate in {"success": "sr", "false_stop": "false_stop_rate", "missed_stop": "missed_stop_rate"}.items():
        assert len(set(found[key])) == 2, f"no variety of {key}: the comparison says nothing"
        assert rates[rate] == pytest.approx(sum(found[key]) / len(found[key]))
    assert (~episodes.success & ~episodes.false_stop & ~episodes.missed_stop).any()


def test_a_memory_ends_the_circles_of_a_greedy_policy_also_in_episodes_that_are_walked_in_parts(world, monkeypatch):
    """A policy that always turns right finds only goals in its place; with the memory it tries what it has not."""
    starts, options = every_start(world), {"observation": SurroundingViews(world), "max_steps": 200}
    without = run_episodes(always(RIGHT, 1.0), world, starts, **options)
    assert without.success.float().mean() < 0.3
    options["memory"] = PlanningMemory()
    remembered = run_episodes(always(RIGHT, 1.0), world, starts, **options)
    assert remembered.success.all()
    monkeypatch.setattr(episodes_module, "MANY", 7)
    parts = run_episodes(always(RIGHT, 1.0), world, starts, **options)
    assert all(torch.equal(a, b) for a, b in zip(vars(remembered).values(), vars(parts).values(), strict=True))


def test_who_sees_arrows_makes_no_blocked_move(world):
    starts = torch.zeros(11, dtype=torch.int64), torch.arange(1, 12)
    protocol = EvaluationProtocol(world, SurroundingViews(world), starts, max_steps=9, arrows=True)
    for memory in (None, PlanningMemory()):
        _, paths = replace(protocol, memory=memory).trajectories(RandomPolicy(), starts, greedy=memory is not None)
        assert all(one != next_one for path in paths for one, next_one in pairwise(path))
        assert sum(map(len, paths)) > 50


def test_where_a_memory_plans_an_agent_stands_beside_its_sweep_and_the_way_to_another_goal():
    rooms = grid_scene(4, 3, name="room", goals=(0, 21, 44)), grid_scene(2, 2, name="small", goals=(1, 14))
    world = make_world(rooms)
    assert other_goals(world).tolist() == [1, 2, 0, 4, 3]
    protocol = EvaluationProtocol(world, SurroundingViews(world), every_start(world), memory=PlanningMemory())
    found = assess(expert(world), protocol)
    assert list(found) == ["shortest_path", "random", "greedy", "sweep", "another_goal"]
    assert found["greedy"]["spl"] == 1
    assert found["sweep"] == report(protocol.run(RandomPolicy()), world)
    assert found["another_goal"]["sr"] == 1  # it stops at its own goal, when it comes to it
    assert found["another_goal"]["spl"] < found["sweep"]["spl"]
    assert list(assess(expert(world), replace(protocol, memory=None)))[2:] == ["greedy", "sampled"]
    lonely = make_world([rooms[0], grid_scene(2, 2, name="small", goals=(1,))])
    lone = replace(protocol, world=lonely, observation=SurroundingViews(lonely), starts=every_start(lonely))
    assert "another_goal" not in assess(expert(lonely), lone)


def episodes(meter, goal, steps, count, frames=0):
    meter.add([goal] * count, [steps] * count, frames)


def test_atl_is_averaged_over_goals_and_forgets_old_episodes():
    meter = EpisodeMeter(3)
    assert math.isnan(meter.measures(31)["atl"])
    episodes(meter, 0, 50, 10)
    episodes(meter, 0, 10, WINDOW)
    episodes(meter, 1, 30, 1)
    assert meter.measures(31) == {"atl": 20.0, "atl_worst_goal": 30.0, "episodes": WINDOW + 11, "sr": 1.0}
    assert (meter.measures(30)["sr"], meter.measures(10)["sr"]) == (0.5, 0.0)


def test_stable_needs_enough_short_episodes_of_every_goal_and_is_lost_again():
    meter = EpisodeMeter(2)
    episodes(meter, 0, 20, WINDOW, frames=1)
    episodes(meter, 1, 20, WINDOW - 1, frames=2)
    assert meter.stable_at is None
    episodes(meter, 1, 20, 1, frames=3)
    assert meter.stable_at == 3
    episodes(meter, 0, 5, 1, frames=4)
    assert meter.stable_at == 3
    episodes(meter, 1, 200, 1, frames=5)
    assert meter.stable_at is None
    episodes(meter, 1, 20, WINDOW, frames=6)
    assert meter.stable_at == 6


def advice(world, goal_index, state):
    """What the expert says in states on the way to goals."""
    return ShortestPathExpert(world)(TensorDict({"state": state, "goal": world.goals[goal_index]}, [len(state)]))


def test_optimal_actions_are_all_that_come_nearer_and_the_expert_takes_the_first(world):
    goal_index, state = (part[world.distances > 0] for part in world.pairs())
    after = world.distance(goal_index.unsqueeze(1), world.graph[state])
    nearer = after < world.distance(goal_index, state).unsqueeze(1)
    advised = advice(world, goal_index, state)
    assert torch.equal(advised["optimal_actions"], nearer)
    assert torch.equal(advised["expert_action"], nearer.int().argmax(1))


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
    advised = advice(world, goal_index, state)
    assert advised["expert_action"].tolist() == [-1] * 4 + [RIGHT]
    probabilities = ShortestPathPolicy(world)(advised)["logits"].softmax(-1)
    assert probabilities.tolist() == [[0.25] * 4] * 4 + [[0, 1, 0, 0]]


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
