"""The experiment on places that change: what each way asks for, and that measurements are kept."""

import json
from dataclasses import replace

import pytest
import torch
from rooms import grid_scene

from dirl.envs import SurroundingViews
from dirl.evaluation.episodes import every_start
from dirl.evaluation.experts import RandomPolicy, ShortestPathPolicy
from dirl.evaluation.protocol import EvaluationProtocol
from dirl.experiments import changes, measures
from dirl.models import PlanningMemory
from dirl.perception.recognition import NCC
from dirl.perception.recognition.tables import VisitScores
from dirl.scenes import make_world
from dirl.training.build import Trained

ROOMS = [grid_scene(3, 2, name=name, goals=(0, 13), seed=seed, looks=2) for seed, name in enumerate(("a", "b"))]


@pytest.fixture
def asked(monkeypatch):
    """What was asked of `load_trained`, which gives a policy that knows the way, stopped at the goal."""
    found = []

    def load_trained(saved, agent, given):
        found.append((agent, given))
        world = make_world(ROOMS)
        protocol = EvaluationProtocol(
            world,
            SurroundingViews(world),
            every_start(world),
            stop=None,
            max_steps=30,
            memory=PlanningMemory(),
            scores=VisitScores(NCC(), world),
        )
        planned = given["episodic_memory"]["_target_"].endswith("PlanningMemory")
        return Trained(None, ShortestPathPolicy(world), protocol if planned else replace(protocol, memory=None))

    monkeypatch.setattr(measures, "load_trained", load_trained)
    monkeypatch.setattr(measures, "load_checkpoint", lambda agent: agent)
    return found


@pytest.mark.parametrize(
    ("way", "recogniser", "memory", "stop"),
    [
        ("ncc", "NCC", "PlanningMemory", "match"),
        ("learned, localising", "Learned", "LocalisingMemory", "match"),
        *((control, "Learned", "PlanningMemory", "goal") for control in changes.CONTROLS),
    ],
)
def test_each_way_has_its_recogniser_memory_and_stop(asked, way, recogniser, memory, stop):
    _, episodes = changes.walked("general", "rooms", "front", way, {})
    ((agent, given),) = asked
    assert (agent, given["scene"], given["stop.evaluation"]) == ("general", "collection:rooms", stop)
    assert given["recogniser"]["_target_"] == f"dirl.perception.recognition.{recogniser}"
    assert given["episodic_memory"]["_target_"] == f"dirl.models.{memory}"
    assert given["observation.goal_view"] == "front"
    if way in ("told when it has arrived", *changes.RECOGNISED):
        assert bool(episodes.success.all())
    else:
        assert episodes.steps.float().mean() > 2 * episodes.shortest.float().mean()


def test_a_folder_without_an_index_is_tested_in_all_its_dumps(asked, tmp_path):
    for name in ("b.h5", "a.h5", "a.toml"):
        (tmp_path / name).touch()
    changes.walked("general", str(tmp_path), "front", "ncc", {})
    (tmp_path / "collection.jsonl").touch()
    changes.walked("general", str(tmp_path), "front", "ncc", {})
    found = [(given["scene"], given["split"]) for _, given in asked]
    assert found == [([f"{tmp_path}/a.h5", f"{tmp_path}/b.h5"], None), (f"collection:{tmp_path}", "test")]


def test_the_controls_walk_as_they_say(asked, monkeypatch):
    walkers = []
    monkeypatch.setattr(
        EvaluationProtocol, "run", lambda self, policy, **options: walkers.append((self, policy, options))
    )
    for way in list(changes.CONTROLS)[1:3]:
        changes.walked("general", "rooms", "surrounding", way, {})
    (wrong, policy, _), (_, sweep, options) = walkers
    assert isinstance(policy, ShortestPathPolicy)
    assert not torch.equal(wrong.shown, torch.arange(len(wrong.world.goals)))
    assert isinstance(sweep, RandomPolicy)
    assert options == {"greedy": True}


def test_agents_share_the_scores_of_a_recogniser_in_a_collection(asked, monkeypatch):
    used, tables = [], {}
    run = EvaluationProtocol.run
    monkeypatch.setattr(EvaluationProtocol, "run", lambda self, *a, **o: used.append(self.scores) or run(self, *a, **o))
    for agent in ("general", "other"):
        for collection, way in (("near", "ncc"), ("near", "patches"), ("far", "ncc")):
            changes.walked(agent, collection, "surrounding", way, tables)
    assert all(first is again for first, again in zip(used[:3], used[3:], strict=True))
    assert len({id(scores) for scores in used}) == 3


def test_a_stop_is_shared_where_recogniser_and_goal_view_are_the_same(monkeypatch):
    stops = []

    def load_agent(agent, options, goal_view, **groups):
        world = make_world(ROOMS)
        protocol = EvaluationProtocol(world, SurroundingViews(world), every_start(world), stop=lambda *ids: None)
        return Trained(None, ShortestPathPolicy(world), protocol)

    monkeypatch.setattr(changes, "load_agent", load_agent)
    monkeypatch.setattr(EvaluationProtocol, "run", lambda self, policy: stops.append(self.stop))
    tables = {}
    cases = [(view, way) for view in changes.GOAL_VIEWS for way in changes.RECOGNISED]
    for agent in ("general", "other"):
        for view, way in cases:
            changes.walked(agent, "near", view, way, tables)
    assert all(first is again for first, again in zip(stops[: len(cases)], stops[len(cases) :], strict=True))
    assert len(set(stops)) == len(cases)


def test_a_report_has_every_case_and_goes_on_from_what_was_measured(asked, tmp_path):
    text = changes.report_changes(["near", "far"], ["general"], tmp_path)
    cases = 2 * 2 * (len(changes.RECOGNISED) + len(changes.CONTROLS))
    assert len(asked) == cases
    assert text.count("| general |") == cases
    assert "| near | four views | general | ncc | 1.000 | 1.000 |" in text
    files = sorted((tmp_path / "measured").iterdir())
    assert len(files) == cases
    assert len(json.loads(files[0].read_text())["spl"]) == len(ROOMS)
    assert (tmp_path / "changes.png").stat().st_size > 10_000
    files[0].unlink()
    assert changes.report_changes(["near", "far"], ["general"], tmp_path) == text
    assert len(asked) == cases + 1
