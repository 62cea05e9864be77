"""The programs of the reports on topological maps, from their command line to their files, on very little."""

import csv
import sys
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from closet import closet
from rooms import grid_scene

from dirl.backbones import ViewEncoder
from dirl.experiments import buildings, graph_latency, wrong_merges
from dirl.rooms.building import Building
from dirl.rooms.building_tour import write_building_tour
from dirl.scenes import load_scenes, write_dump
from dirl.scenes.views import encode

ATTRIBUTES = {"extractor": "means", "preprocessing": "none", "weights": "none", "provenance": "a test"}


def run(monkeypatch, program, *arguments):
    monkeypatch.setattr(sys, "argv", [program.__name__, *map(str, arguments)])
    program.main()


def rows_of(file):
    with file.open() as stream:
        return list(csv.DictReader(stream))


@pytest.fixture(scope="module")
def tours(tmp_path_factory):
    """The folder of a report on one building of two closets, and of its tour."""
    pytest.importorskip("embreex")
    folder = tmp_path_factory.mktemp("tours")
    two = Building("closets", (closet(), closet("#c8553d", "#205080")), (0.6,))
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(buildings, "BUILDINGS", {7: ("closet", "closet")})
        monkeypatch.setattr(buildings, "sample_building", lambda kinds, seed: two)
        small = partial(write_building_tour, apart=1.0, size=(32, 64))
        monkeypatch.setattr(buildings, "write_building_tour", small)
        given = ["general", "--tours", folder, "--out", folder / "report", "--goals", 2, "--starts", 2]
        run(monkeypatch, buildings, *given)
    return folder


def test_a_building_is_walked_through_as_a_tour(tours, monkeypatch):
    rows = rows_of(tours / "report" / "image_graph.csv")
    assert {row["scenes"] for row in rows if "scenes" in row} <= {"1"}
    assert {float(row["SR"]) for row in rows if row["led by"] == "graph, walk of 2 N steps"} == {1}
    led = {row["led by"] for row in rows if "by the policy" in row["led by"] or "to the goal" in row["led by"]}
    names = [f"graph, last {last} by the policy with memory" for last in ("3 steps", "1 step")]
    names.append("graph to the goal, policy only where it knows no way")
    assert led == {name + view for name in names for view in ("", ", one photo of the goal")}
    (scene,) = load_scenes(str(tours / "building_7.h5"))
    assert len(scene) % 8 == 0
    assert scene.source == "tour"
    monkeypatch.setattr(buildings, "write_building_tour", None)  # a tour that is there is not made again
    assert buildings.make_building(7, tours, None) == str(tours / "building_7.h5")


def test_what_takes_long_is_timed_for_each_part(tours, monkeypatch):
    monkeypatch.setattr(graph_latency, "STEPS", 1)
    nodes, found = graph_latency.latencies(load_scenes(str(tours / "building_7.h5"))[0])
    assert nodes > 0
    assert len(found) == 5
    assert min(found) >= 0


def test_disturbed_views_are_measured_at_each_strength(tmp_path, monkeypatch):
    scene = grid_scene(4, 3, feature_width=64)
    rng = np.random.default_rng(0)
    views = [rng.integers(0, 256, (4, 5, 3), np.uint8) for _ in range(len(scene))]
    features = np.stack([view.flatten() for view in views]).astype(np.float32)
    write_dump(tmp_path / "room.h5", replace(scene, features=features), [encode(view, quality=None) for view in views])
    pixels = ViewEncoder(lambda batch: batch.flatten(1).float(), ATTRIBUTES)
    rooms = SimpleNamespace(select=lambda split: load_scenes(str(tmp_path / "room.h5")))
    monkeypatch.setattr(wrong_merges, "read_collection", lambda folder: rooms)
    monkeypatch.setattr(wrong_merges, "load_encoder", lambda *names, **options: pixels)
    monkeypatch.setattr(wrong_merges, "STARTS", 2)
    given = ["my_rooms", "--out", tmp_path / "report", "--kinds", "noise", "--goals", 2]
    run(monkeypatch, wrong_merges, *given)
    rows = rows_of(tmp_path / "report" / "wrong_merges.csv")
    assert [(row["disturbance"], float(row["strength"])) for row in rows] == [("none", 0), ("noise", 16), ("noise", 64)]
    assert [float(rows[0][f"SR {sign}"]) for sign in "-+"] == [1, 1]
    assert float(rows[2]["nodes a state +"]) >= float(rows[0]["nodes a state +"]) == 1
    assert (tmp_path / "report" / "wrong_merges.png").exists()
    look = wrong_merges.disturbed_looks(rooms.select("test")[0], pixels, "noise", 16)
    clean = torch.from_numpy(features)[torch.tensor(scene.surrounding)[3]]
    off = (look(3) - clean).abs()
    assert 0 < off.mean() < 16
