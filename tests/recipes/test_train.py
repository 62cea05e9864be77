"""The recipe that trains: what a run leaves, with goals held out, and from the weights of another run."""

import json
import shutil
import signal

import pytest
import torch
from commands import SAVED, TINY, done, evaluated, room_file, rows_of, run_recipe, start_recipe, summary_of, wait_until
from rooms import grid_scene

from dirl.runs.checkpoints import load_checkpoint
from dirl.scenes import write_dump


def test_train_leaves_a_whole_run_and_evaluate_repeats_its_result(tmp_path):
    file = room_file(tmp_path)
    printed = done(tmp_path, "train", f"scene={file}", *TINY, "stop.training=match")
    assert "| greedy " in printed
    (run,) = tmp_path.glob("runs/*/*")
    names = {"config.yaml", "summary.json", "network.pt", "learning_curve.png", "trajectories_grid.png"}
    names |= {"maps_grid.png", "episode_grid.gif", "imitation.csv", "reinforcement.csv", "evaluation.csv"}
    assert {entry.name for entry in run.iterdir()} == names
    summary = summary_of(run)
    facts = {"scene": "grid", "source": "synthetic", "system": "dirl", "preset": "fast", "seed": 3, "frames": 600}
    assert facts.items() <= summary.items()
    assert {"stable_at_frame", "seconds", "frames_per_second", "peak_memory_mb"} <= set(summary)
    measures = {"atl", "atl_success", "sr", "spl", "shortest", "false_stop_rate", "missed_stop_rate", "episodes"}
    for mode in ("greedy", "sampled", "random", "shortest_path"):
        assert measures <= set(summary[mode])
        assert set(summary[mode]["scenes"]["grid"]["goals"]) == {"0", "13"}
    assert [row["frames"] for row in rows_of(run / "evaluation.csv")] == ["0", "300", "600"]

    _, again = evaluated(run, "seed=3", "max_steps=50")
    assert all(again[mode] == summary[mode] for mode in ("greedy", "sampled", "random", "shortest_path"))


def test_a_run_until_stable_ends_at_the_first_evaluation_that_finds_every_goal_stable(tmp_path):
    options = [f"scene={room_file(tmp_path)}", *TINY, "imitation.fraction=1", "reinforcement.until=stable"]
    options += ["reinforcement.frames_per_scene=20_000", "evaluation.times=20", "hydra.run.dir=run"]
    done(tmp_path, "train", *options)
    summary = summary_of(tmp_path / "run")
    evaluated = [int(row["frames"]) for row in rows_of(tmp_path / "run" / "evaluation.csv")]
    assert summary["stable_at_frame"] is not None
    assert [frames for frames in evaluated if frames > summary["stable_at_frame"]] == [summary["frames"]]
    assert summary["frames"] < 20_000


def test_benchmark_measures_every_loop(tmp_path):
    room = room_file(tmp_path)
    options = [f"worlds=[{room}]", "frames_per_scene=240", "repeats=1", "out=benchmark.json"]
    small = "encoder.width=32,heads.width=32,reinforcement.agents_per_scene=6"
    small += ",imitation.max_steps=2,reinforcement.frames_per_scene=240"
    train = "train=[" + ",".join(f"'{option}'" for option in small.split(",")) + "]"
    printed = done(tmp_path, "benchmark", *options, train)
    (row,) = json.loads((tmp_path / "benchmark.json").read_text())["rows"]
    assert set(row["frames_per_second"]) == {"training", "rollout", "stock_torchrl"}
    assert all(rate > 0 for rate in row["frames_per_second"].values())
    assert row["operations_per_frame"] > 0
    assert row["stable_at_frame"] is None
    assert "fraction of limit" in printed


def test_an_error_of_the_machine_in_one_job_of_a_sweep_leaves_the_others(tmp_path):
    (tmp_path / "sweep" / "0" / "learning_curve.png").mkdir(parents=True)  # where a file is to be
    options = [f"scene={room_file(tmp_path)}", *TINY[1:], "hydra.sweep.dir=sweep", "seed=3,4"]
    status, _, errors = run_recipe(tmp_path, "train", "-m", *options)
    assert status != 0
    assert "failed: sweep/0: " in errors
    assert (tmp_path / "sweep" / "1" / "learning_curve.png").is_file()
    assert (tmp_path / "sweep" / "1" / "summary.json").is_file()


@pytest.mark.parametrize("policy", ["actor_critic", "shortest_path"])
def test_goals_held_out_are_evaluated_apart(tmp_path, policy):
    asked = [f"scene={room_file(tmp_path)}", "goals=all", "hold_out=0.34", f"policy={policy}", "hydra.run.dir=run"]
    printed = done(tmp_path, "train", *TINY, *asked)
    assert "Goals held out of the training:" in printed
    summary = summary_of(tmp_path / "run")
    goals = [set(part["greedy"]["scenes"]["grid"]["goals"]) for part in (summary, summary["held_out"])]
    assert [len(part) for part in goals] == [16, 8]
    assert not goals[0] & goals[1]
    if policy == "shortest_path":
        greedy = summary["held_out"]["greedy"]
        assert greedy["sr"] + greedy["false_stop_rate"] + greedy["missed_stop_rate"] >= 1
        return
    header = (tmp_path / "run" / "evaluation.csv").read_text().splitlines()[0]
    assert header.endswith("held_out_sr,held_out_spl")
    _, again = evaluated(tmp_path / "run", "seed=7")  # another seed draws other actions, but no other goals
    assert again["greedy"] == summary["greedy"]
    assert again["held_out"]["greedy"] == summary["held_out"]["greedy"]


ANY_GOAL = ["seed=3", "system=any_goal", "hold_out=0.34", "network.components=8", "encoder.width=32"]
ANY_GOAL += ["encoder.comparison=16", "heads.width=32", "imitation.batch_size=64", "imitation.max_steps=40"]
ANY_GOAL += ["evaluation.max_steps=30", "evaluation.goals=3"]


def test_goal_view_and_memory_are_chosen_at_evaluation(tmp_path):
    printed = done(tmp_path, "train", *ANY_GOAL, f"scene={room_file(tmp_path, patches=True)}", "hydra.run.dir=run")
    assert "Goals held out of the training:" in printed
    found = {}
    asked = {"four": [], "photo": ["goal_view=front"], "alone": ["episodic_memory=none"]}
    for name, options in {**asked, "named": ["goals=[0,1,5,7,13]"]}.items():
        _, result = evaluated(tmp_path / "run", *options)
        found[name] = result["greedy"]["atl"]
    goals = {int(goal) for goal in result["greedy"]["scenes"]["grid"]["goals"]}
    assert goals == {0, 1, 5, 7, 13}  # of those that are named all count, though the run drew three
    summary = summary_of(tmp_path / "run")
    assert found["four"] == summary["greedy"]["atl"]
    assert len(set(found.values())) == 4


OTHER = [*(option for option in TINY if ".width" not in option), "scene=other.h5", "system=dirl"]
"""Reinforcement in another room; the architecture is the checkpoint's."""


@pytest.fixture(scope="module")
def pretrained(tmp_path_factory):
    """A folder with a run with heads for any room (``run``), and with another room (``other.h5``)."""
    folder = tmp_path_factory.mktemp("pretrained")
    room_file(folder)
    write_dump(folder / "other.h5", grid_scene(goals=(2, 9), feature_width=32, seed=1, name="other"))
    options = [*TINY, "scene=room.h5", "heads=shared", "network.components=12", "hydra.run.dir=run"]
    done(folder, "train", *options)
    return folder


def test_a_training_begins_with_the_weights_and_the_architecture_of_another(pretrained):
    still = ["reinforcement.frames_per_scene=6", "imitation.fraction=0", "optimiser.lr=0", "evaluation.times=1"]
    done(pretrained, "train", *OTHER, "init=run", *still, "hydra.run.dir=still")
    before, after = (load_checkpoint(pretrained / name) for name in ("run", "still"))
    assert after["scenes"] == ["other"]
    assert before["network"].keys() == after["network"].keys()
    for name, value in before["network"].items():
        assert torch.equal(value, after["network"][name]), name


def test_it_learns_and_when_it_is_resumed_does_not_need_the_weights_it_began_with(pretrained):
    (pretrained / "lent").mkdir()
    shutil.copy(pretrained / "run" / "network.pt", pretrained / "lent")
    options = [*OTHER, "init=lent/network.pt", "reinforcement.frames_per_scene=1500", SAVED]
    killed = pretrained / "killed"
    process = start_recipe(pretrained, "train", *options, "hydra.run.dir=killed")
    wait_until(lambda: list(killed.glob("checkpoints/0*[1-9]??.pt")))
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not (killed / "summary.json").exists(), "it was not killed in time"
    shutil.rmtree(pretrained / "lent")
    done(pretrained, "train", "resume=killed")
    assert summary_of(killed)["frames"] == 1500
    before, tuned = (load_checkpoint(pretrained / name)["network"] for name in ("run", "killed"))
    assert any(not torch.equal(value, tuned[name]) for name, value in before.items())
    assert torch.equal(tuned["features.axes"], before["features.axes"])  # those of its features


@pytest.mark.parametrize(
    ("option", "told"),
    [
        ("encoder.width=16", "its checkpoint decides the architecture; leave out encoder.width=16"),
        ("scene=far.h5", "was trained on features of another extractor: 'random', not 'another'"),
    ],
)
def test_what_cannot_be_begun_with_is_told_in_one_line(pretrained, option, told):
    write_dump(pretrained / "far.h5", grid_scene(goals=(2,), feature_width=32, name="far", extractor="another"))
    status, _, errors = run_recipe(pretrained, "train", *OTHER, "init=run", option, "hydra.run.dir=refused")
    assert (status, errors) == (1, f"error: init=run: {told}\n")
    assert not (pretrained / "refused").exists()
