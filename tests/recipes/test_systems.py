"""The systems beside DIRL: two that learn nothing, DAgger, and workers that learn at the same time."""

import runpy
import signal
import sys

import pytest
import torch
from commands import ROOT, TINY, done, evaluated, room_file, rows_of, run_recipe, start_recipe, summary_of, wait_until
from parts import make_parts
from refusals import refused

from dirl.config.components import make
from dirl.training.hogwild import fetch, share


def test_a_system_that_learns_nothing_is_measured_like_the_others(tmp_path):
    """The system `random` is one of a grid in `test_experiments.py`."""
    options = [f"scene={room_file(tmp_path)}", *TINY, "system=shortest_path", "hydra.run.dir=run"]
    printed = done(tmp_path, "train", *options)
    summary = summary_of(tmp_path / "run")
    assert summary["greedy"] == summary["sampled"] == summary["shortest_path"]
    assert (summary["system"], summary["greedy"]["sr"]) == ("shortest_path", 1)
    assert "| greedy " in printed


def test_a_memory_that_localises_goes_on_with_the_map_of_a_walk(tmp_path):
    """Of a policy that has hardly learnt, in a room that changes."""
    room = room_file(tmp_path, looks=2, patches=True)
    done(tmp_path, "train", f"scene={room}", *TINY, "system=il", "imitation.fraction=0.1", "hydra.run.dir=run")
    (tmp_path / "odds.yaml").write_text("_target_: odds.Odds\n")
    asked = ["recogniser=odds.yaml", "trust=[odds]", "episodic_memory=localising", "stop=match"]
    spl = []
    for mapped in ([], ["map=3"]):
        printed, found = evaluated(tmp_path / "run", *asked, *mapped)
        spl.append(found["greedy"]["spl"])
        assert ("1.00 nodes a state, 100 % of the states, 0.0 % of the moves wrong" in printed) == bool(mapped)
    assert spl[1] > 0.95 > spl[0]
    _, _, errors = run_recipe(tmp_path, "evaluate", "checkpoint=run", *asked, "map=3", "last_steps=0")
    assert errors.endswith("last_steps=0: a memory that localises knows its map to the end; leave it out\n")


def test_a_map_leads_a_policy_to_the_last_steps_that_are_given(tmp_path):
    """Of a policy that has hardly learnt: the nearer to the goal the map leads it, the more often it arrives."""
    options = [f"scene={room_file(tmp_path)}", *TINY, "system=il", "imitation.fraction=0.1", "hydra.run.dir=run"]
    done(tmp_path, "train", *options)
    spl = []
    for last_steps, told in (
        ([], "the greedy policy decides the last 3 steps"),
        (["last_steps=0"], "map of one walk to the goal"),
    ):
        _, found = evaluated(tmp_path / "run", "map=2", "viewer=true", *last_steps)
        spl.append(found["greedy"]["spl"])
        (page,) = (tmp_path / "run").glob("viewer_*.html")
        assert told in page.read_text()
    assert spl[1] > 0.95 > spl[0]
    _, found = evaluated(tmp_path / "run", "arrows=true")
    assert found["greedy"]["sr"] > 0


def test_dagger_labels_more_states_every_round_and_clones_better_than_before(tmp_path):
    sizes = ["reinforcement.agents_per_scene=20", "imitation.fraction=0.1", "imitation.rounds=3", "imitation.lr=3e-3"]
    options = [f"scene={room_file(tmp_path)}", *TINY, "system=dagger", *sizes, "hydra.run.dir=run"]
    done(tmp_path, "train", *options)
    rows = rows_of(tmp_path / "run" / "dagger.csv")
    assert [row["frames"] for row in rows] == ["400", "800", "1200"]
    labels = [int(row["labels"]) for row in rows]
    assert labels == sorted(labels)
    assert labels[-1] > 3 * 4  # the demonstrations: 2 states for each goal
    summary = summary_of(tmp_path / "run")
    assert summary["demonstrations"] == labels[-1]
    assert summary["frames"] == 1200
    assert summary["greedy"]["sr"] > 0.8


@pytest.mark.parametrize("optimiser", ["adam", "tf_rmsprop"])
def test_shared_weights_start_as_the_network_and_shared_statistics_as_the_optimisers_own(tmp_path, optimiser):
    options = [f"scene={room_file(tmp_path)}", "encoder.width=8", "heads.width=8"]
    options += [f"optimiser={optimiser}", "optimiser.lr=0.1"]
    alone, other = (make_parts(*options) for _ in range(2))
    first, second = (
        make("optimiser", parts.config.optimiser, params=parts.policy.parameters()) for parts in (alone, other)
    )
    shared = share(other.policy, second, frames=7)
    assert shared.claimed.value == 7
    assert all(weight.is_shared() for weight in shared.weights)
    assert all(value.is_shared() for of_weight in shared.statistics for value in of_weight.values())
    for parts, stepping in ((alone, first), (other, second)):
        for parameter in parts.policy.parameters():
            parameter.grad = torch.full_like(parameter, 0.5)
        stepping.step()
    for mine, theirs in zip(alone.policy.parameters(), other.policy.parameters(), strict=True):
        assert torch.equal(mine, theirs)
    fetch(shared, other.policy)
    for mine, theirs in zip(shared.weights, other.policy.parameters(), strict=True):
        assert torch.equal(mine, theirs)


@pytest.mark.parametrize("wrong", [["reinforcement.agents_per_scene=3"], ["device=cuda"]], ids=str)
def test_workers_that_cannot_be_are_refused(tmp_path, wrong, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    refused(r"reinforcement\.workers=4: ", make_parts, f"scene={room_file(tmp_path)}", "system=a3c", *wrong)


def test_workers_learn_are_stopped_by_ctrl_c_and_go_on(tmp_path, monkeypatch):
    small = ["encoder.width=64", "heads.width=64", "imitation.fraction=0", "optimiser.lr=4e-3"]
    small += ["reinforcement.agents_per_scene=40", "reinforcement.workers=2"]
    options = [f"scene={room_file(tmp_path)}", *TINY, "system=a3c", *small, "reinforcement.frames_per_scene=16_000"]
    process = start_recipe(tmp_path, "train", *options, "hydra.run.dir=run", "checkpoint.every_seconds=1000")
    table = tmp_path / "run" / "reinforcement.csv"
    wait_until(lambda: table.exists())
    process.send_signal(signal.SIGINT)
    ended = process.wait()
    assert ended.status == 130
    assert "resume=run" in ended.errors
    assert "Traceback" not in ended.errors
    (checkpoint,) = (tmp_path / "run" / "checkpoints").glob("*.pt")
    assert 0 < int(checkpoint.stem) < 16_000
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["train.py", "resume=run"])
    runpy.run_path(str(ROOT / "recipes" / "train.py"), run_name="__main__")  # here workers are forks of the server
    summary = summary_of(tmp_path / "run")
    assert summary["frames"] == 16_000
    # How far they come depends on how the machine shares its time between them.
    assert summary["sampled"]["spl"] > summary["random"]["spl"] + 0.05
