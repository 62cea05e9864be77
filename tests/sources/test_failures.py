"""Simulators that fail: each run ends in one line that says what, where and what to do, and leaves whole files."""

import os
import signal
from contextlib import suppress
from pathlib import Path

import pytest
from commands import done, run_recipe, wait_until


def process_of(name):
    """The number of the process that has a word among its arguments; None if there is none."""
    for arguments in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):  # of a process that has just ended
            if name.encode() in arguments.read_bytes().split(b"\0"):
                return int(arguments.parent.name)
    return None


MORTAL = """
import os, signal
from types import SimpleNamespace

from networks import coarse_networks
from test_failures import process_of

from dirl.sources.vizdoom import VizDoom

coarse_networks(SimpleNamespace(setattr=setattr))


class Mortal(VizDoom):
    "VizDoom that is killed before the view of that number; if it is negative, the program that looks is."

    def __init__(self, name, last):
        super().__init__(name, height=60, width=80)
        self.left, self.own = abs(last), last < 0

    def look(self, heading):
        self.left -= 1
        if not self.left:
            name = self._game.get_instance_id()
            print(name, flush=True)
            os.kill(os.getpid() if self.own else process_of(name), signal.SIGKILL)
        return super().look(heading)
"""

DUMP = ["simulator", "simulator=doom.yaml", "step=2", "places=2"]

TRAINING = "scene=doom.h5 goals=every:6 env=live env.simulator=doom.yaml env.views=2000 network.components=8"
TRAINING += " encoder.width=8 heads.width=8 imitation.max_steps=1 reinforcement.agents_per_scene=2"
TRAINING += " reinforcement.frames_per_scene=20 evaluation.times=0 evaluation.live_episodes=1 evaluation.max_steps=2"
TRAINING += " checkpoint.every_seconds=0 env.turn_error=5"  # so that every view is a new one


@pytest.fixture
def doom(tmp_path, monkeypatch):
    """Write the file of a VizDoom that is killed before a view."""
    pytest.importorskip("vizdoom", reason="the extra vizdoom is not installed")
    (tmp_path / "mortal.py").write_text(MORTAL)
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{Path(__file__).parent}", prepend=os.pathsep)

    def write(last):
        (tmp_path / "doom.yaml").write_text(f"_target_: mortal.Mortal\nname: map01\nlast: {last}\n")

    return write


def test_a_doom_that_is_killed_ends_a_training_in_one_line_and_it_is_resumed(doom, tmp_path):
    doom(last=0)
    done(tmp_path, "scenes", *DUMP, "out=doom.h5", "encoder=efficientnet_lite0")
    dump = (tmp_path / "doom.h5").read_bytes()
    doom(last=60)
    status, _, errors = run_recipe(tmp_path, "train", *TRAINING.split(), "hydra.run.dir=run")
    assert status == 1
    told = errors.splitlines()[-1]
    assert told.startswith("error: freedoom2_map01: VizDoom failed (ViZDoomErrorException: Unexpected ")
    assert "; its last checkpoint is safe; resume with: " in told
    assert told.endswith(" resume=run")
    assert "Traceback" not in errors
    doom(last=0)
    assert "20 frames" in done(tmp_path, "train", "resume=run", "trust=[mortal]")
    assert (tmp_path / "doom.h5").read_bytes() == dump


def test_no_doom_outlives_a_program_that_is_killed(doom, tmp_path):
    doom(last=-1)
    status, printed, _ = run_recipe(tmp_path, "scenes", *DUMP, "out=doom.h5", "encoder=null")
    assert status == -signal.SIGKILL
    wait_until(lambda: not list(Path("/dev/shm").glob(f"ViZDoom*{printed.strip()}")))
    wait_until(lambda: process_of(printed.strip()) is None)  # which ends a moment later
