"""The experiment on walks and later visits: whose looks are seen when, what is measured, and that it is kept."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from odds import Odds
from rooms import grid_scene

from dirl.envs import SurroundingViews
from dirl.evaluation import episodes as episodes_module
from dirl.evaluation.episodes import Episodes, every_start
from dirl.evaluation.experts import ShortestPathPolicy
from dirl.evaluation.protocol import EvaluationProtocol
from dirl.experiments import walked_once
from dirl.models import LocalisingMemory
from dirl.perception.recognition.matching import TemplateStop
from dirl.perception.recognition.tables import VisitScores
from dirl.runs.paths import RunError
from dirl.scenes import make_world, read_dump, write_dump
from dirl.training.build import Trained

SIZE = {"feature_width": 64, "patches": True, "looks": 2, "noise": 0.05}


@pytest.fixture
def collections(tmp_path, monkeypatch):
    """Two collections of the same two rooms."""
    entries = [
        SimpleNamespace(name=name, split=split) for name, split in (("a", "test"), ("b", "test"), ("c", "train"))
    ]
    monkeypatch.setattr(walked_once, "read_collection", lambda folder: SimpleNamespace(entries=entries))
    for seed, folder in enumerate(("before", "after")):
        for room, name in enumerate(("a", "b")):
            scene = grid_scene(3, 2, name=name, goals=(0, 13), seed=room, **SIZE)
            moved = replace(scene, look_features=scene.look_features + np.float16(0.01 * seed))
            write_dump(tmp_path / folder / f"{name}.h5", moved)
    return tmp_path / "before", tmp_path / "after"


@pytest.fixture
def loaded(monkeypatch):
    """A policy that knows the way, in the rooms that are asked for."""

    def load(agent, files, view):
        world = make_world([read_dump(file) for file in files])
        match = "front" if view == "front" else "views"
        protocol = EvaluationProtocol(
            world,
            SurroundingViews(world, view),
            every_start(world),
            TemplateStop(0.0, match, Odds()).compared(world),
            40,
            memory=LocalisingMemory(),
            scores=VisitScores(Odds(), world),
        )
        return Trained(None, ShortestPathPolicy(world), protocol)

    monkeypatch.setattr(walked_once, "_loaded", load)


def test_the_walk_sees_the_first_collection_and_the_episodes_the_changes_of_the_second(collections, tmp_path):
    before, after = collections
    files, (walk, later, photos) = walked_once.rooms(f"{before}:{after}", tmp_path / "both")
    assert [file.rsplit("/", 1)[1] for file in files] == ["a.h5", "b.h5"]
    assert (walk, later, photos) == (range(3), range(3, 5), None)
    both, changed = read_dump(files[1]), read_dump(after / "b.h5")
    assert np.array_equal(both.look_features[2:], changed.look_features)
    assert np.array_equal(both.look_patches[2:], changed.look_patches)
    assert np.array_equal(both.look_features[:2], read_dump(before / "b.h5").look_features)
    assert walked_once.rooms(str(before), tmp_path)[1] == [None, None, None]
    assert walked_once.rooms(f"{before}:{after}:{after}", tmp_path)[1] == [range(3), range(3, 5), range(5, 7)]
    assert walked_once.rooms(f"{before}::{after}", tmp_path)[1] == [range(3), range(3), range(3, 5)]


def test_collections_of_other_rooms_or_without_looks_are_refused(collections, tmp_path):
    before, after = collections
    write_dump(after / "a.h5", grid_scene(3, 2, name="a", goals=(0,), **{**SIZE, "looks": 0}))
    with pytest.raises(RunError, match="after: a has no looks; make it with looks=2"):
        walked_once.rooms(f"{before}:{after}", tmp_path / "both")
    write_dump(after / "a.h5", grid_scene(2, 2, name="a", goals=(0,), **SIZE))
    with pytest.raises(RunError, match="a is another room than in"):
        walked_once.rooms(f"{before}:{after}", tmp_path / "both")


def test_collections_with_patches_of_other_kinds_are_refused(collections, tmp_path):
    before, after = collections
    write_dump(before / "a.h5", grid_scene(3, 2, name="a", goals=(0, 13), **{**SIZE, "patches": "fine"}))
    with pytest.raises(RunError, match="a has patches of 2 kinds; encode all folders alike"):
        walked_once.rooms(f"{before}:{after}", tmp_path / "both")


def test_walks_and_episodes_see_the_looks_that_they_should(collections, loaded, tmp_path, monkeypatch):
    before, after = collections
    walks, episodes, map_scene, run = [], [], walked_once.map_scene, EvaluationProtocol.run
    monkeypatch.setattr(walked_once, "map_scene", lambda *given: walks.append(given[-1]) or map_scene(*given))
    monkeypatch.setattr(
        EvaluationProtocol, "run", lambda self, policy: episodes.append(self.looks) or run(self, policy)
    )
    walked_once.measure("general", *walked_once.rooms(f"{before}:{after}", tmp_path / "both"))
    assert walks == [range(3)] * 2
    assert episodes == [range(3, 5)] * 6


def test_a_report_has_every_way_and_goes_on_from_what_was_measured(collections, loaded, tmp_path, monkeypatch):
    before, after = collections
    asked = [str(before), f"{before}:{after}"]
    text = walked_once.report_walked_once(asked, "general", tmp_path / "out")
    assert "| before | map of the walk | 1.000 | 1.000 | 0.000 |" in text
    assert text.count("| before then after | ") == 2 + 2 * len(walked_once.WAYS)
    assert "| before then after | four views | map of the walk | 1.000 | 1.000 | 0.000 | 0.000 |" in text
    assert "| before | one photo | map, another goal's views | 0.000 | 0.000 | 1.000 |" in text
    assert (tmp_path / "out" / "walked_once.png").stat().st_size > 10_000
    monkeypatch.setattr(walked_once, "measure", lambda *_: pytest.fail("measured again"))
    assert walked_once.report_walked_once(asked, "general", tmp_path / "out") == text


def test_goals_can_be_photos_of_another_camera(collections, loaded, tmp_path, monkeypatch):
    before, after = collections
    wanted, walked = [], episodes_module.run_episodes
    monkeypatch.setattr(
        episodes_module,
        "run_episodes",
        lambda policy, protocol, **how: (
            wanted.append((protocol.looks, protocol.photos)) or walked(policy, protocol, **how)
        ),
    )
    text = walked_once.report_walked_once([f"{before}:{before}:{after}"], "general", tmp_path / "out")
    assert wanted == [(range(3, 5), range(5, 7))] * 2
    rows = [line for line in text.splitlines() if line.startswith("| before then before then after | map")]
    assert rows[-2].split(" | ")[1:] == ["map of the walk", "1.000", "1.000", "0.000", "0.000", "1.000 |"]
    assert rows[-1].split(" | ")[1:5] == ["map, another goal's views", "0.000", "0.000", "1.000"]
    assert "four views" not in text


def test_stops_at_the_place_of_the_goal_count_facing_any_way():
    world = make_world([grid_scene(3, 2, name=name, goals=(0, 13), feature_width=64) for name in "ab"])
    # Room, last state of the room, whether the agent stopped there; the goal is state 0, whose place has states 0 to 3.
    ended = [(0, 0, True), (0, 2, True), (0, 4, True), (0, 3, False), (1, 1, True), (1, 5, True)]
    room, last, stopped = (torch.tensor(column) for column in zip(*ended, strict=True))
    right = stopped & (last == 0)
    goals, start = 2 * room, 24 * room + 9
    episodes = Episodes(goals, start, *[torch.ones(6)] * 2, right, stopped & ~right, torch.zeros(6, dtype=torch.bool))
    paths = [[0, state] for state in (24 * room + last).tolist()]
    assert walked_once.stops_at_places(world, episodes, paths) == [0.5, 0.5]


def test_an_image_graph_leads_to_goals_in_rooms_that_do_not_change():
    world = make_world([grid_scene(3, 2, goals=(0, 13), feature_width=64)])
    graphs, quality = walked_once.image_graphs(world, None)
    assert quality == {"nodes": [1.0]}
    protocol = EvaluationProtocol(world, SurroundingViews(world), every_start(world), max_steps=30)
    for view in ("surrounding", "front"):
        episodes = walked_once.by_image_graphs(graphs, protocol, view)
        assert bool(episodes.success.all())
        assert torch.equal(episodes.steps, episodes.shortest)
