"""Jobs of a sweep that are trained as one program."""

import csv
import json
from types import SimpleNamespace

import pytest
import torch
from commands import TINY, room_file, train_config
from pretend_graph import pretend
from train import imitation, learn, train

from dirl.cli.parsing import compose_training
from dirl.runs.checkpoints import load_checkpoint
from dirl.training.job import build_components
from dirl.training.loops import Updates
from dirl.training.together import Job, run_together, why_alone

SHORT = [*TINY, "imitation.max_steps=25", "reinforcement.frames_per_scene=240", "checkpoint.every_seconds=0"]


def jobs_in(folder, room, *options, changes=(("seed=1",), ("seed=2", "imitation.fraction=0.25"), ("seed=3",))):
    jobs = []
    for number, own in enumerate(changes):
        given = [f"scene={room}", *SHORT, "existing=keep", *options, *own]
        jobs.append(Job(compose_training(given), folder / str(number), given))
    return jobs


def weights_in(folder):
    return load_checkpoint(folder)["network"]


def rows_of(file):
    with file.open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_every_job_of_a_stack_has_the_folder_it_would_have_alone(tmp_path, capsys):
    room = room_file(tmp_path)
    changes = (("seed=1",), ("seed=2",), ("seed=3", "reinforcement.until=stable"))
    together = run_together(jobs_in(tmp_path / "stack", room, changes=changes), train, imitation, learn)
    told = capsys.readouterr().out
    assert f"2 runs as one: {tmp_path / 'stack/0'}, {tmp_path / 'stack/1'}" in told
    assert f"by itself: {tmp_path / 'stack/2'}: until=stable" in told
    assert together[2]["frames"] == 240
    assert (tmp_path / "stack/2/network.pt").is_file()
    for number in range(2):
        (alone,) = run_together(
            jobs_in(tmp_path / f"alone{number}", room, changes=changes[number : number + 1]), train, imitation, learn
        )
        folder, own = tmp_path / "stack" / str(number), tmp_path / f"alone{number}" / "0"
        assert {file.name for file in folder.iterdir()} == {file.name for file in own.iterdir()}
        sizes = [(one / "network.pt").stat().st_size for one in (folder, own)]
        assert sizes[0] == pytest.approx(sizes[1], rel=0.05)
        assert (folder / "config.yaml").read_text() == (own / "config.yaml").read_text()
        saved = json.loads((folder / "summary.json").read_text())
        assert saved["greedy"]["sr"] == together[number]["greedy"]["sr"]
        assert together[number]["frames"] == alone["frames"] == 240
        steps = rows_of(folder / "imitation.csv")
        assert [row["step"] for row in steps] == [row["step"] for row in rows_of(own / "imitation.csv")]
        assert len(rows_of(folder / "evaluation.csv")) == 3


def test_a_stack_that_was_killed_goes_on_to_the_same_bits(tmp_path, monkeypatch):
    room = room_file(tmp_path)
    assert not [
        one
        for one in run_together(jobs_in(tmp_path / "whole", room), train, imitation, learn)
        if isinstance(one, Exception)
    ]
    record, count = Updates.record, []

    def killed(loop, reports):
        record(loop, reports)
        count.append(1)
        if len(count) == 4:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Updates, "record", killed)
        with pytest.raises(KeyboardInterrupt):
            run_together(jobs_in(tmp_path / "parts", room), train, imitation, learn)
    run_together(jobs_in(tmp_path / "parts", room), train, imitation, learn)
    for number in range(3):
        whole, parts = (tmp_path / name / str(number) for name in ("whole", "parts"))
        saved, after = weights_in(whole), weights_in(parts)
        assert all(torch.equal(value, after[name]) for name, value in saved.items())
        for name in ("imitation.csv", "evaluation.csv"):
            assert (whole / name).read_text() == (parts / name).read_text()


def test_a_run_that_diverges_does_not_end_the_others(tmp_path, capsys):
    room = room_file(tmp_path)
    changes = (("seed=1",), ("seed=2", "optimiser.lr=1e30"))
    fine, failed = run_together(jobs_in(tmp_path, room, changes=changes), train, imitation, learn)
    assert fine["frames"] == 240
    assert "diverged" in str(failed)
    assert "diverged" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "reason"),
    [
        ("seed=2", None),
        ("memory=gru", "memory"),
        ("objective=none", "by reinforcement"),
        ("env.slip=0.1", "environment"),
    ],
)
def test_what_cannot_be_stacked_is_told(option, reason, tmp_path):
    run = SimpleNamespace(config=train_config(f"scene={room_file(tmp_path)}", *TINY, option), saved=None, folder="run")
    told = why_alone(run, build_components(run))
    assert told is None if reason is None else reason in told


def test_a_run_alone_is_captured_too(tmp_path, monkeypatch, capsys):
    room = room_file(tmp_path)
    graphs = pretend(monkeypatch)
    (alone,) = run_together(jobs_in(tmp_path, room, changes=(("seed=1",),)), train, imitation, learn)
    assert alone["frames"] == 240
    assert len(graphs) == 1
    assert capsys.readouterr().err.count("CUDA graph") == 0
