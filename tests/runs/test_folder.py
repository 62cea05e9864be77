"""The folder of a run: tables, checkpoints, and what becomes of it when a process dies or files are lost."""

import errno
import json
import math
import os

import pytest
import torch
import wandb
from commands import train_config, wait_until
from PIL import Image
from refusals import refused
from rooms import grid_scene

from dirl.config.files import config_text
from dirl.runs.checkpoints import RunError, is_finished, load_checkpoint, save_checkpoint, training_checkpoints
from dirl.runs.folder import Run, open_run
from dirl.runs.loggers import WandbLogger
from dirl.scenes import make_world


def config(*options):
    return train_config("checkpoint.every_seconds=0", "checkpoint.keep=2", *options)


def begin(run):
    run.begin(make_world([grid_scene()]), ["ahead", "right", "back", "left"])
    return run


def begun(folder, saved=None):
    return begin(Run(folder, config(), saved))


def state(frames):
    return {"frames": frames, "network": {"w": torch.zeros(100)}}


def opened(folder, *options):
    return open_run(config(*options), folder, options)


def resumed(folder):
    return opened(folder, f"resume={folder}")


def saved_run(folder, *frames):
    run = begun(folder)
    for number in frames:
        run.write("evaluation", number, {"frames": number})
        run.save(state(number))
    run.close()
    return training_checkpoints(folder)


def test_a_resumed_run_keeps_its_columns_and_forgets_rows_younger_than_its_checkpoint(tmp_path):
    run = begun(tmp_path)
    run.write("evaluation", 1, {"frames": 1, "atl": math.nan, "old": 3})
    run.save(state(10))
    for stage in ("evaluation", "reinforcement"):
        run.write(stage, 15, {"frames": 15, "atl": 1.0, "old": 3})
    run.close()
    (tmp_path / "notes.csv").write_text("mine\n")
    run = begun(tmp_path, load_checkpoint(tmp_path))
    run.write("evaluation", 11, {"frames": 11, "sr": 0.5, "atl": 8.25})
    assert (tmp_path / "evaluation.csv").read_text().split() == ["frames,atl,old", "1,,3", "11,8.25,"]
    assert (tmp_path / "reinforcement.csv").read_text() == ""
    assert (tmp_path / "notes.csv").read_text() == "mine\n"


def test_only_the_latest_checkpoints_stay_and_none_after_the_end(tmp_path):
    run = Run(tmp_path, train_config("checkpoint.every_seconds=30"), None)
    run.last_save -= 61
    assert (run.save_due(2), run.save_due(3)) == (True, False)  # runs that are saved together are saved more rarely
    run = begun(tmp_path)
    for frames in (9, 10, 100):
        run.save(state(frames))
    assert [int(file.stem) for file in training_checkpoints(tmp_path)] == [10, 100]
    saved = load_checkpoint(tmp_path)
    assert (saved["frames"], saved["scenes"], saved["extractor"]) == (100, ["grid"], "random")
    assert saved["config"] == (tmp_path / "config.yaml").read_text()
    run.finish(state(200), {"sr": math.nan})
    run.clean_up({})
    assert training_checkpoints(tmp_path) == []
    assert load_checkpoint(tmp_path)["frames"] == 200
    assert json.loads((tmp_path / "summary.json").read_text()) == {"sr": None}


def test_two_runs_begun_in_the_same_second_get_two_folders(tmp_path):
    asked = tmp_path / "2026-01-31_12-00-00"
    first, second = (opened(asked) for _ in range(2))
    begin(first)
    begin(second).close()
    names = [run.folder.name for run in (first, second, begun(asked))]
    assert names == [f"{asked.name}{number}" for number in ("", "-2", "-3")]
    job = tmp_path / "multirun" / asked.name / "0"
    assert [begun(job).folder.name for _ in range(2)] == ["0", "0-2"]


def test_a_running_run_is_neither_resumed_nor_begun_again(tmp_path):
    run = begun(tmp_path)
    run.save(state(10))
    for option in (f"resume={tmp_path}", "existing=keep"):
        refused(rf"{tmp_path}: process {os.getpid()} on .* is writing to it", opened, tmp_path, option)
    run.close()
    with pytest.raises(RunError, match="is writing to it"):
        [resumed(tmp_path) for _ in range(2)]


def test_a_run_that_could_not_begin_leaves_nothing_behind(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("WANDB_MODE", "online")
    monkeypatch.delenv("WANDB_API_KEY", raising=False)
    begun(tmp_path / "2026-01-31_12-00-00").close()
    for folder in (tmp_path / "b", tmp_path / "2026-01-31_12-00-00"):
        refused("nobody is logged in", begin, Run(folder, config("logger=wandb")))
    assert {file.name for file in tmp_path.rglob("*") if file.is_file()} == {"config.yaml"}
    assert not (tmp_path / "2026-01-31_12-00-00-2").exists()


def test_a_damaged_checkpoint_is_set_aside_and_the_one_before_is_gone_on_from(tmp_path, capsys):
    first, second = saved_run(tmp_path, 10, 20)
    second.write_bytes(second.read_bytes()[:-100])
    (tmp_path / "checkpoints" / ".unfinished-0123.pt").write_bytes(b"half")  # what a killed process left
    run = opened(tmp_path, "existing=keep")  # as a grid comes back to it
    assert run.saved["frames"] == 10
    (told,) = capsys.readouterr().err.splitlines()
    assert told.startswith(f"{second}: is damaged or no checkpoint of this version of dirl")
    assert told.endswith(f"; going back to the one before, {first.name}")
    begin(run)
    assert training_checkpoints(tmp_path) == [first]
    assert sorted(file.name for file in first.parent.iterdir()) == [first.name, f"{second.name}.damaged"]
    run.close()
    first.write_bytes(b"")
    refused(rf"to begin this run again from its start, delete {tmp_path / 'checkpoints'}$", resumed, tmp_path)


def test_a_checkpoint_whose_tables_are_shorter_than_it_says_is_not_gone_on_from(tmp_path, capsys):
    _, second = saved_run(tmp_path, 10, 20)
    table = tmp_path / "evaluation.csv"
    rows = table.read_text()
    os.truncate(table, len(rows) - 1)
    assert resumed(tmp_path).saved["frames"] == 10
    assert f"does not fit {table}, which is shorter" in capsys.readouterr().err
    table.unlink()
    refused("which is shorter than it was, or missing", resumed, tmp_path)
    table.write_text(rows)
    save_checkpoint(second, {key: value for key, value in load_checkpoint(second).items() if key != "tables"})
    assert resumed(tmp_path).saved["frames"] == 10
    assert "is no checkpoint of a training; it lacks tables" in capsys.readouterr().err


@pytest.mark.parametrize("deleted", ["config.yaml", "evaluation.csv"])
def test_what_somebody_deletes_of_a_running_run_ends_it(tmp_path, deleted):
    run = begun(tmp_path)
    run.write("evaluation", 10, {"frames": 10, "atl": 3.0})
    (tmp_path / deleted).unlink()
    steps = [lambda: run.save(state(20)), lambda: run.finish(state(20), {})]
    if deleted == "evaluation.csv":
        steps.append(lambda: run.write("evaluation", 20, {"frames": 20, "atl": 2.0}))
    for step in steps:
        with pytest.raises(FileNotFoundError, match=deleted):
            step()
    assert not (tmp_path / deleted).exists()
    assert not training_checkpoints(tmp_path)
    assert not (tmp_path / "summary.json").exists()


def test_a_stopped_run_says_what_is_safe_and_how_to_go_on(tmp_path, monkeypatch):
    run = Run(tmp_path / "run", config())
    assert run.how_to_go_on() == "nothing of this run was saved"
    begin(run)
    again = f"resume with: python recipes/train.py resume={tmp_path / 'run'}"
    assert run.how_to_go_on() == f"it has no checkpoint yet; {again}"
    run.save(state(10))

    def full(descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(OSError, match=r"No space left on device: .*20\.pt"):
            run.save(state(20))
    assert [file.name for file in (tmp_path / "run" / "checkpoints").iterdir()] == ["000000000010.pt"]
    assert run.how_to_go_on() == f"its last checkpoint is safe; {again}"
    run.finish(state(10), {})
    run.clean_up({})
    assert run.how_to_go_on() == f"the run is finished: {tmp_path / 'run'}"
    assert not list((tmp_path / "run").glob(".*"))


def test_resume_takes_no_other_option_and_no_finished_run_and_none_is_overwritten(tmp_path):
    run = begun(tmp_path)
    run.close()
    for again in (opened, begun):
        refused(f"{tmp_path}: holds a run already", again, tmp_path)
    refused("leave out seed=1", opened, tmp_path, f"resume={tmp_path}", "seed=1")
    run.finish(state(0), {})
    refused("is finished", resumed, tmp_path)
    assert is_finished(opened(tmp_path, "existing=keep").folder)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """That of a finished run, and nobody is logged in."""
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("WANDB_MODE", "WANDB_API_KEY", "WANDB_RUN_ID"):
        monkeypatch.delenv(name, raising=False)
    wandb.teardown()  # it keeps what the environment of an earlier test said
    monkeypatch.chdir(tmp_path)
    run = tmp_path / "dirl_bathroom_02" / "run"
    run.mkdir(parents=True)
    (run / "network.pt").write_bytes(b"the weights")
    (run / "summary.json").write_text("{}")
    Image.new("RGB", (8, 6)).save(run / "maps.png")
    return run


def log_a_run(folder, *options):
    config = train_config("scene=bathroom_02", *options)
    (folder / "config.yaml").write_text(config_text(config))
    logger = WandbLogger(config, folder)
    logger.log("imitation", 27, {"step": 27, "loss": 0.5})
    logger.log("evaluation", 0, {"frames": 0, "spl": 0.1, "atl": math.nan})  # a lower step than the one before
    logger.log("evaluation", 300, {"frames": 300, "spl": 0.2, "atl": 9.0})
    logger.finish({"frames": 600, "scene": "bathroom_02", "greedy": {"spl": 0.25, "atl": math.nan}}, folder)


def test_wandb_gets_everything_and_goes_on_as_the_same_run(folder, monkeypatch, capfd):
    monkeypatch.setenv("WANDB_RUN_ID", "ofthesweep")  # as an agent of a sweep gives it
    log_a_run(folder, "logger=wandb", "logger.tags=[night]", "seed=77")
    said = capfd.readouterr()
    assert "upload it by: wandb sync" in said.out
    assert not said.err  # the last line of a run is its own
    (told,) = folder.glob("wandb/offline-run-*/run-*.wandb")
    # A process of wandb's writes the file, and on a busy machine after the run has finished here.
    wait_until(lambda: b"network.pt" in told.read_bytes(), patience=300)
    record = told.read_bytes()
    expected = ["night", "fast", "bathroom_02", "dirl_bathroom_02", "agents_per_scene", "dirl-ofthesweep", "network.pt"]
    expected += ["imitation/loss", "evaluation/spl", "greedy.spl", "pictures/maps"]
    assert [words for words in expected if words.encode() not in record] == []
    assert list(folder.glob("wandb/offline-run-*/files/media/images/pictures/maps*.png"))
    monkeypatch.delenv("WANDB_RUN_ID")
    log_a_run(folder, "logger=wandb")
    assert {file.name for file in folder.glob("wandb/offline-run-*/run-*.wandb")} == {"run-ofthesweep.wandb"}
