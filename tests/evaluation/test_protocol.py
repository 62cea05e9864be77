import json
from itertools import pairwise

import pytest
import torch
from networks import make_policy
from policies import RIGHT, Asked, always, only_goals, outcome, pair, run_episodes

from dirl.envs import SequentialViews, SurroundingViews
from dirl.evaluation.episodes import every_start, shortest_episodes
from dirl.evaluation.protocol import EvaluationProtocol, mean_shortest, report

KINDS = (SurroundingViews, SequentialViews)
BOTH = pytest.mark.parametrize("kind", KINDS)


@BOTH
def test_a_networks_trajectories_are_its_episodes_walked_by_asking_it_directly(world, kind):
    network = make_policy(world.features, world.names, width=16, seed=5)
    starts, options = every_start(world), {"observation": kind(world), "max_steps": 30}
    direct = run_episodes(Asked(lambda rows: network(rows.copy())["logits"]), world, starts, **options)
    network.cache(None if kind.history else world.surrounding)
    protocol = EvaluationProtocol(world, starts=starts, **options)
    episodes, paths = protocol.trajectories(network, starts)
    assert outcome(episodes) == outcome(protocol.run(network)) == outcome(direct)
    assert [path[0] for path in paths] == starts[1].tolist()
    assert [len(path) - 1 for path in paths] == episodes.steps.tolist()
    assert torch.equal(torch.tensor([path[-1] for path in paths]) == world.goals[starts[0]], episodes.success)
    assert all(after in world.graph[before] for path in paths for before, after in pairwise(path))
    assert len(set(episodes.success.tolist())) == 2


def test_a_report_covers_each_scene_and_each_goal_by_its_number_in_the_scene(world):
    episodes = run_episodes(always(RIGHT), world, every_start(world), observation=SurroundingViews(world), max_steps=10)
    summary = report(episodes, world)
    assert {name: list(scene["goals"]) for name, scene in summary["scenes"].items()} == {
        "room": ["0", "13"],
        "corner": ["6"],
        "split": ["1"],
    }
    # Three starts each are at the goal's own place.
    assert summary["scenes"]["room"]["sr"] == pytest.approx(6 / 46)
    assert summary["scenes"]["room"]["goals"]["13"]["sr"] == pytest.approx(3 / 23)
    assert summary["scenes"]["corner"]["goals"]["6"]["sr"] == pytest.approx(3 / 11)
    assert summary["scenes"]["split"]["sr"] == 1
    json.dumps(summary)


def test_a_reports_parts_add_up(world):
    stop = only_goals(world) & (world.pairs()[0] != 2)
    stop[pair(world, 0, 2)] = True
    options = {"observation": SurroundingViews(world), "stop": stop, "max_steps": 10}
    summary = report(run_episodes(always(RIGHT), world, every_start(world), **options), world)
    scenes = list(summary["scenes"].values())
    for whole, parts in [(summary, scenes)] + [(scene, list(scene["goals"].values())) for scene in scenes]:
        assert whole["episodes"] == sum(part["episodes"] for part in parts)
        for measure in ("atl", "spl", "false_stop_rate", "missed_stop_rate"):
            total = sum(part[measure] * part["episodes"] for part in parts)
            assert whole[measure] == pytest.approx(total / whole["episodes"])


def test_the_mean_shortest_way_is_that_of_all_starts_of_a_goal(world):
    episodes = shortest_episodes(world, every_start(world))
    means = [episodes.select(episodes.goal_index == index).steps.double().mean().item() for index in range(4)]
    assert mean_shortest(world) == pytest.approx(means)
