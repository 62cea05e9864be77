import csv
import json
import math
import os
import sys

import pytest
import torch
from commands import train_config
from rooms import grid_scene

from dirl.config.schemas import ConfigError
from dirl.evaluation.stability import WINDOW, EpisodeMeter
from dirl.runs.checkpoints import load_checkpoint, save_checkpoint
from dirl.runs.folder import Run, open_run
from dirl.runs.paths import RunError, training_checkpoints
from dirl.scenes import make_world


def config(*options):
    return train_config("checkpoint.every_seconds=0", "checkpoint.keep=2", *options)


def begun(folder, saved=None):
    run = Run(folder, config(), saved)
    run.begin(make_world([grid_scene()]), ["ahead", "right", "back", "left"])
    return run


def episodes(meter, goal, steps, count, frames=0):
    meter.add([goal] * count, [steps] * count, frames)


def test_rows_become_a_csv_file_with_empty_cells_for_nan(tmp_path):
    run = begun(tmp_path)
    run.write("evaluation", 0, {"frames": 0, "atl": math.nan})
    run.write("evaluation", 5, {"frames": 5, "atl": 1.25})
    assert (tmp_path / "evaluation.csv").read_text().split() == ["frames,atl", "0,", "5,1.25"]


def test_a_resumed_run_keeps_the_columns_that_it_has(tmp_path):
    run = begun(tmp_path)
    run.write("reinforcement", 1, {"frames": 1, "atl": 9.5, "old": 3})
    run.save({"frames": 10, "network": {}})
    run.close()
    resumed = begun(tmp_path, load_checkpoint(tmp_path))
    resumed.write("reinforcement", 11, {"frames": 11, "sr": 0.5, "atl": 8.25})
    assert (tmp_path / "reinforcement.csv").read_text().split() == ["frames,atl,old", "1,9.5,3", "11,8.25,"]


def test_a_resumed_run_forgets_rows_younger_than_its_checkpoint(tmp_path):
    run = begun(tmp_path)
    run.write("evaluation", 0, {"frames": 0})
    run.save({"frames": 10, "network": {}})
    run.write("evaluation", 5, {"frames": 5})
    run.write("reinforcement", 5, {"frames": 5})
    run.close()
    (tmp_path / "notes.csv").write_text("mine\n")
    begun(tmp_path, load_checkpoint(tmp_path))
    assert (tmp_path / "notes.csv").read_text() == "mine\n"
    with (tmp_path / "evaluation.csv").open() as stream:
        assert list(csv.DictReader(stream)) == [{"frames": "0"}]
    assert (tmp_path / "reinforcement.csv").read_text() == ""


def test_only_the_latest_checkpoints_stay_and_none_after_the_end(tmp_path):
    run = begun(tmp_path)
    for frames in (9, 10, 100):
        run.save({"frames": frames, "network": {}})
    assert [file.stem.lstrip("0") for file in training_checkpoints(tmp_path)] == ["10", "100"]
    assert load_checkpoint(tmp_path)["frames"] == 100
    run.finish({"frames": 200, "network": {}}, {"sr": math.nan})
    run.clean_up({})
    assert training_checkpoints(tmp_path) == []
    assert load_checkpoint(tmp_path)["frames"] == 200
    assert json.loads((tmp_path / "summary.json").read_text()) == {"sr": None}


def test_a_checkpoint_tells_the_configuration_scenes_and_extractor(tmp_path):
    begun(tmp_path).save({"frames": 1, "network": {}})
    saved = load_checkpoint(tmp_path)
    assert saved["scenes"] == ["grid"]
    assert saved["extractor"] == "random"
    assert saved["config"] == (tmp_path / "config.yaml").read_text()


def test_a_folder_that_holds_a_run_is_not_overwritten(tmp_path):
    begun(tmp_path).close()
    with pytest.raises(RunError, match=f"{tmp_path}: holds a run already"):
        open_run(config(), tmp_path, [])
    with pytest.raises(RunError, match=f"{tmp_path}: holds a run already"):
        begun(tmp_path)


def test_two_runs_begun_in_the_same_second_get_two_folders(tmp_path):
    asked = tmp_path / "2026-01-31_12-00-00"
    first, second = (open_run(config(), asked, []) for _ in range(2))
    for run in (first, second):
        run.begin(make_world([grid_scene()]), ["ahead", "right", "back", "left"])
    second.close()
    third = begun(asked)
    assert [run.folder.name for run in (first, second, third)] == [asked.name, f"{asked.name}-2", f"{asked.name}-3"]
    assert begun(tmp_path / "multirun" / "2026-01-31_12-00-00" / "0").folder.name == "0"
    assert begun(tmp_path / "multirun" / "2026-01-31_12-00-00" / "0").folder.name == "0-2"


def test_a_running_run_is_neither_resumed_nor_begun_again(tmp_path):
    run = begun(tmp_path)
    run.save({"frames": 10, "network": {}})
    for options in ([f"resume={tmp_path}"], ["existing=keep"]):
        with pytest.raises(RunError, match=rf"{tmp_path}: process {os.getpid()} on .* is writing to it"):
            open_run(config(*options), tmp_path, options)
    run.close()
    with pytest.raises(RunError, match="is writing to it"):
        [open_run(config(f"resume={tmp_path}"), tmp_path, []) for _ in range(2)]


def test_a_run_that_could_not_begin_leaves_nothing_behind(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "wandb", None)
    for folder in (tmp_path / "a", tmp_path / "2026-01-31_12-00-00"):
        begun(folder).close()
        run = Run(folder if folder.name != "a" else tmp_path / "b", config("logger=wandb"))
        with pytest.raises(ConfigError, match="not installed"):
            run.begin(make_world([grid_scene()]), ["ahead", "right", "back", "left"])
    assert {file.name for file in tmp_path.rglob("*") if file.is_file()} == {"config.yaml"}
    assert not (tmp_path / "2026-01-31_12-00-00-2").exists()


def resumed(folder):
    return open_run(config(f"resume={folder}"), folder, [])


def saved_run(folder, *frames):
    run = begun(folder)
    for number in frames:
        run.write("evaluation", number, {"frames": number})
        run.save({"frames": number, "network": {"w": torch.zeros(100)}})
    run.close()
    return training_checkpoints(folder)


def test_the_configuration_is_written_once_and_taken_from_a_checkpoint_if_it_was_lost(tmp_path, capsys):
    saved_run(tmp_path, 10)
    file = tmp_path / "config.yaml"
    before = file.stat()
    run = resumed(tmp_path)
    run.begin(make_world([grid_scene()]), ["ahead", "right", "back", "left"])
    run.close()
    assert (file.stat().st_ino, file.stat().st_mtime_ns) == (before.st_ino, before.st_mtime_ns)
    text = file.read_text()
    for lose in (lambda: file.write_text(""), file.unlink):
        lose()
        run = resumed(tmp_path)
        assert "config.yaml: is empty or missing; taken from a checkpoint" in capsys.readouterr().err
        run.begin(make_world([grid_scene()]), ["ahead", "right", "back", "left"])
        run.close()
        assert file.read_text() == text


def test_a_damaged_checkpoint_is_set_aside_and_the_one_before_is_gone_on_from(tmp_path, capsys):
    first, second = saved_run(tmp_path, 10, 20)
    second.write_bytes(second.read_bytes()[:-100])
    run = resumed(tmp_path)
    assert run.saved["frames"] == 10
    told = capsys.readouterr().err.splitlines()
    assert told == [
        f"{second}: is damaged or no checkpoint of this version of dirl: it does not end with a digest; "
        f"going back to the one before, {first.name}"
    ]
    run.begin(make_world([grid_scene()]), ["ahead", "right", "back", "left"])
    assert training_checkpoints(tmp_path) == [first]
    assert second.with_name(second.name + ".damaged").exists()
    run.save({"frames": 15, "network": {}})
    assert load_checkpoint(tmp_path)["frames"] == 15
    run.close()
    for file in training_checkpoints(tmp_path):
        file.write_bytes(b"")
    with pytest.raises(RunError, match=rf"to begin this run again from its start, delete {tmp_path / 'checkpoints'}$"):
        resumed(tmp_path)


def test_a_checkpoint_whose_tables_are_shorter_than_it_says_is_not_gone_on_from(tmp_path, capsys):
    _, second = saved_run(tmp_path, 10, 20)
    table = tmp_path / "evaluation.csv"
    rows = table.read_text()
    os.truncate(table, len(rows) - 1)
    assert resumed(tmp_path).saved["frames"] == 10
    assert f"does not fit {table}, which is shorter" in capsys.readouterr().err
    table.unlink()
    with pytest.raises(RunError, match="which is shorter than it was, or missing"):
        resumed(tmp_path)
    table.write_text(rows)
    save_checkpoint(second, {key: value for key, value in load_checkpoint(second).items() if key != "tables"})
    assert resumed(tmp_path).saved["frames"] == 10
    assert "is no checkpoint of a training; it lacks tables" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("deleted", "step"),
    [
        ("config.yaml", "save"),
        ("config.yaml", "finish"),
        ("evaluation.csv", "write"),
        ("evaluation.csv", "save"),
        ("evaluation.csv", "finish"),
    ],
)
def test_what_somebody_deletes_of_a_running_run_ends_it(tmp_path, deleted, step):
    run = begun(tmp_path)
    run.write("evaluation", 10, {"frames": 10, "atl": 3.0})
    (tmp_path / deleted).unlink()
    steps = {
        "write": lambda: run.write("evaluation", 20, {"frames": 20, "atl": 2.0}),
        "save": lambda: run.save({"frames": 20, "network": {}}),
        "finish": lambda: run.finish({"frames": 20, "network": {}}, {}),
    }
    with pytest.raises(FileNotFoundError, match=deleted):
        steps[step]()
    assert not (tmp_path / deleted).exists()
    assert not training_checkpoints(tmp_path)
    assert not (tmp_path / "summary.json").exists()


def test_what_killed_processes_left_is_removed(tmp_path):
    saved_run(tmp_path, 10)
    for folder in (tmp_path, tmp_path / "checkpoints"):
        (folder / ".unfinished-0123.pt").write_bytes(b"half")
    run = resumed(tmp_path)
    assert run.saved["frames"] == 10
    run.begin(make_world([grid_scene()]), ["ahead", "right", "back", "left"])
    run.close()
    assert not [file.name for file in tmp_path.rglob(".*")]


def test_a_stopped_run_says_what_is_safe_and_how_to_go_on(tmp_path):
    run = Run(tmp_path / "run", config())
    assert run.how_to_go_on() == "nothing of this run was saved"
    run.begin(make_world([grid_scene()]), ["ahead", "right", "back", "left"])
    again = f"resume with: python recipes/train.py resume={tmp_path / 'run'}"
    assert run.how_to_go_on() == f"it has no checkpoint yet; {again}"
    run.save({"frames": 10, "network": {}})
    assert run.how_to_go_on() == f"its last checkpoint is safe; {again}"
    run.finish({"frames": 10, "network": {}}, {})
    run.clean_up({})
    assert run.how_to_go_on() == f"the run is finished: {tmp_path / 'run'}"
    assert not list((tmp_path / "run").glob(".*"))


def test_resume_takes_no_other_option_and_no_finished_run(tmp_path):
    run = begun(tmp_path)
    run.close()
    with pytest.raises(RunError, match="leave out seed=1"):
        open_run(config(f"resume={tmp_path}"), tmp_path, [f"resume={tmp_path}", "seed=1"])
    run.finish({"frames": 0, "network": {}}, {})
    with pytest.raises(RunError, match="is finished"):
        open_run(config(f"resume={tmp_path}"), tmp_path, [f"resume={tmp_path}"])


@pytest.mark.parametrize("again", ["resume", "existing=keep"])
def test_a_run_killed_while_it_cleans_up_leaves_nothing(tmp_path, again):
    run = begun(tmp_path)
    run.save({"frames": 10, "network": {}})
    run.finish({"frames": 10, "network": {}}, {})
    run.clean_up({})
    (tmp_path / "checkpoints").mkdir()
    (tmp_path / ".lock").write_text("process 1 on another")
    if again == "resume":
        with pytest.raises(RunError, match="is finished"):
            open_run(config(f"resume={tmp_path}"), tmp_path, [f"resume={tmp_path}"])
    else:
        assert open_run(config(again), tmp_path, [again]).finished
    assert sorted(file.name for file in tmp_path.iterdir()) == ["config.yaml", "network.pt", "summary.json"]


def test_atl_is_averaged_over_goals_and_forgets_old_episodes():
    meter = EpisodeMeter([6, 6, 6])
    assert math.isnan(meter.atl)
    episodes(meter, 0, 50, 10)
    episodes(meter, 0, 10, WINDOW)
    episodes(meter, 1, 30, 1)
    assert (meter.atl, meter.worst_atl, meter.episodes) == (20.0, 30.0, WINDOW + 11)
    assert (meter.success_rate(31), meter.success_rate(30), meter.success_rate(10)) == (1.0, 0.5, 0.0)


def test_stable_needs_enough_short_episodes_of_every_goal_and_is_lost_again():
    meter = EpisodeMeter([6, 6])
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


def test_a_restored_meter_goes_on_as_if_nothing_had_happened():
    meter, other = EpisodeMeter([6]), EpisodeMeter([6])
    episodes(meter, 0, 20, WINDOW + 5, frames=9)
    other.load_state_dict(json.loads(json.dumps(meter.state_dict())))
    for one in (meter, other):
        episodes(one, 0, 30, 3, frames=10)
    assert meter.state_dict() == other.state_dict()
    assert other.steps[0].maxlen == WINDOW
