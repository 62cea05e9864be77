"""Training and evaluation from Python."""

import json

import hydra
import pytest
from hydra.core.global_hydra import GlobalHydra
from refusals import refused
from rooms import grid_scene

import dirl
from dirl.scenes import write_dump
from dirl.training.python import as_arguments

TINY = {"encoder": {"width": 32}, "heads": {"width": 32}, "imitation": {"fraction": 0.2, "max_steps": 20}}
TINY |= {"reinforcement": {"frames_per_scene": 300, "agents_per_scene": 6}}
TINY |= {"evaluation": {"times": 1, "max_steps": 20}}


@pytest.fixture
def room(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_dump(tmp_path / "room.h5", grid_scene(name="room", goals=(3, 7)))
    return "room.h5"


def test_a_run_is_trained_evaluated_and_drawn(room):
    run = dirl.train("network.components=8", scene=room, seed=4, out="first", **TINY)
    assert run.folder.name == "first"
    assert run.summary == json.loads((run.folder / "summary.json").read_text())
    assert "| greedy" in repr(run)
    assert run.plot().width > 100
    measures = run.evaluate(goals=[5], max_steps=9)
    assert list(measures["greedy"]["scenes"]["room"]["goals"]) == ["5"]
    assert "| goal 5" in measures._repr_markdown_()
    assert run.navigator(encoder=lambda images: images, extractor="random").view_order
    with pytest.raises(ValueError, match="has no picture 'path'; choose from learning_curve"):
        run.plot("path")


def test_several_seeds_make_several_runs_also_inside_another_hydra_application(room):
    with hydra.initialize(version_base="1.3", config_path=None):
        outer = GlobalHydra.instance().hydra
        runs = dirl.train(scene=room, seeds=[5, 2], out="both", **TINY)
        assert GlobalHydra.instance().hydra is outer
        assert hydra.compose(overrides=["+own=3"]).own == 3
    assert [run.summary["seed"] for run in runs] == [5, 2]
    assert [str(run.folder) for run in runs] == ["both/seed_5", "both/seed_2"]
    assert all((run.folder / "network.pt").is_file() for run in runs)
    assert "| SPL | 2 of 2 |" in repr(runs)


def test_what_is_wrong_is_an_error_of_one_line(room):
    refused("there is no option 'sed'", dirl.train, scene=room, sed=3)
    for seeds in (-1, 1.5, "12", [2, 2], [None]):
        refused("must be a number of seeds, or a list of different ones", dirl.train, scene=room, seeds=seeds)
    refused("there is no option 'goal'", dirl.evaluate, "general", goal=3)


def test_options_are_written_as_on_the_command_line():
    options = {"goals": {"a b": [1, 2]}, "imitation": {"rounds": 2}, "scene": "it's", "init": None, "x": [True, 0.5]}
    told = ["goals={a b:[1, 2]}", "imitation.rounds=2", 'scene="it\'s"', "init=null", "x=[true, 0.5]"]
    assert as_arguments(options) == told
