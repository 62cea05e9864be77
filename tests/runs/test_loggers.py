"""What a run logs elsewhere, without the services: the files of an offline run."""

import math

import pytest
from commands import train_config, wait_until
from PIL import Image

from dirl.config.files import config_text
from dirl.runs.loggers import WandbLogger


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """That of a finished run, and nobody is logged in."""
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("WANDB_MODE", "WANDB_API_KEY", "WANDB_RUN_ID"):
        monkeypatch.delenv(name, raising=False)
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
