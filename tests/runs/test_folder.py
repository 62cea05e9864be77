import csv
import json
import math

import pytest
import torch
from commands import train_config
from rooms import grid_scene

from dirl.runs.folder import (
    Run,
    RunError,
    load_checkpoint,
    open_run,
    save_checkpoint,
    training_checkpoints,
    write_json,
)
from dirl.scenes import make_world
from dirl.training.progress import WINDOW, EpisodeMeter


def config(*options):
    return train_config("checkpoint.every_seconds=0", "checkpoint.keep=2", *options)


def begun(folder, saved=None):
    run = Run(folder, config(), saved)
    run.begin(make_world([grid_scene()]))
    return run


def episodes(meter, goal, steps, count, frames=0):
    meter.add([goal] * count, [steps] * count, frames)


def test_rows_become_a_csv_file_with_empty_cells_for_nan(tmp_path):
    run = begun(tmp_path)
    run.write("evaluation", 0, {"frames": 0, "atl": math.nan})
    run.write("evaluation", 5, {"frames": 5, "atl": 1.25})
    assert (tmp_path / "evaluation.csv").read_text().split() == ["frames,atl", "0,", "5,1.25"]


def test_a_resumed_run_forgets_rows_younger_than_its_checkpoint(tmp_path):
    run = begun(tmp_path)
    run.write("evaluation", 0, {"frames": 0})
    run.save({"frames": 10, "network": {}})
    run.write("evaluation", 5, {"frames": 5})
    run.write("reinforcement", 5, {"frames": 5})
    begun(tmp_path, load_checkpoint(tmp_path))
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
    run.clean_up()
    assert training_checkpoints(tmp_path) == []
    assert load_checkpoint(tmp_path)["frames"] == 200
    assert json.loads((tmp_path / "summary.json").read_text()) == {"sr": None}


def test_a_checkpoint_tells_the_configuration_scenes_and_extractor(tmp_path):
    begun(tmp_path).save({"frames": 1, "network": {}})
    saved = load_checkpoint(tmp_path)
    assert saved["scenes"] == ["grid"]
    assert saved["extractor"] == "random"
    assert saved["config"] == (tmp_path / "config.yaml").read_text()


def test_a_checkpoint_that_fails_to_be_written_leaves_the_old_one(tmp_path):
    file = tmp_path / "a.pt"
    save_checkpoint(file, {"frames": 1, "network": {}, "config": "", "extractor": ""})
    with pytest.raises(Exception, match=r"pickle|serializ"):
        save_checkpoint(file, {"frames": (number for number in ())})
    assert load_checkpoint(file)["frames"] == 1


@pytest.mark.parametrize("spoil", [lambda data: data[: len(data) // 2], lambda data: b"", lambda data: b"junk" * 100])
def test_a_damaged_checkpoint_is_named(tmp_path, spoil):
    begun(tmp_path).save({"frames": 7, "network": {"w": torch.zeros(1000)}})
    (file,) = training_checkpoints(tmp_path)
    file.write_bytes(spoil(file.read_bytes()))
    with pytest.raises(RunError, match=rf"{file}: is damaged or no checkpoint .* delete it"):
        load_checkpoint(tmp_path)


def test_a_file_with_something_else_is_no_checkpoint(tmp_path):
    torch.save({"weights": 1}, tmp_path / "other.pt")
    with pytest.raises(RunError, match=r"other\.pt: is no checkpoint of dirl"):
        load_checkpoint(tmp_path / "other.pt")


def test_a_folder_that_holds_a_run_is_not_overwritten(tmp_path):
    begun(tmp_path)
    with pytest.raises(RunError, match=f"{tmp_path}: holds a run already"):
        open_run(config(), tmp_path, [])


def test_resume_takes_no_other_option_and_no_finished_run(tmp_path):
    run = begun(tmp_path)
    with pytest.raises(RunError, match="leave out seed=1"):
        open_run(config(f"resume={tmp_path}"), tmp_path, [f"resume={tmp_path}", "seed=1"])
    run.finish({"frames": 0, "network": {}}, {})
    with pytest.raises(RunError, match="is finished"):
        open_run(config(f"resume={tmp_path}"), tmp_path, [f"resume={tmp_path}"])


def test_json_is_whole_or_not_there(tmp_path):
    with pytest.raises(TypeError):
        write_json(tmp_path / "a.json", {"a": object()})
    assert not (tmp_path / "a.json").exists()


def test_atl_is_averaged_over_goals_and_forgets_old_episodes():
    meter = EpisodeMeter([6, 6, 6])
    assert math.isnan(meter.atl)
    episodes(meter, 0, 50, 10)
    episodes(meter, 0, 10, WINDOW)
    episodes(meter, 1, 30, 1)
    assert (meter.atl, meter.worst_atl, meter.episodes) == (20.0, 30.0, WINDOW + 11)


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
