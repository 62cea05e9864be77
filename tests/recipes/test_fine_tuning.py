"""Trainings that begin with the weights of another one, in a room that it was not trained in."""

import shutil
import signal

import pytest
import torch
from commands import SAVED, TINY, done, room_file, run_recipe, start_recipe, summary_of, wait_until
from rooms import grid_scene

from dirl.runs.checkpoints import load_checkpoint
from dirl.scenes import write_dump

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
