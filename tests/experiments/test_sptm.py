"""SPTM's protocol: where its mazes are found (``SPTM``, a clone of github nsavinov/SPTM), an episode of them."""

import os
from pathlib import Path

import numpy as np
import pytest

from dirl.experiments import sptm
from dirl.experiments.sptm import AHEAD, IDLE, STARTS, STEPS, TESTS, VALIDATION, Game, random_walker, walk
from dirl.scenes.scene import SceneError

FOLDER = Path(os.environ.get("SPTM", "SPTM"))

found = pytest.mark.skipif(not (FOLDER / "data").is_dir(), reason="SPTM=... is no clone of github nsavinov/SPTM")


class Straight:
    """A maze that is one corridor; the agent walks 10 units a step."""

    def __init__(self):
        self.at = 0.0

    def start(self, name):
        self.at = 0.0

    def act(self, action, steps=4):
        self.at += 10 * steps * (action == AHEAD)

    def see(self):
        return None, np.array([self.at, 0.0])


def test_an_episode_ends_within_63_units_or_after_5000_steps():
    assert walk(Straight(), "map02", (500, 0), lambda frame: AHEAD) == (True, 44)  # at 440 units
    assert walk(Straight(), "map02", (500, 0), lambda frame: IDLE) == (False, STEPS)
    assert walk(Straight(), "map02", (63, 0), lambda frame: IDLE) == (True, 0)


def test_the_protocol_has_672_episodes():
    assert len(TESTS) * len(STARTS) * len(TESTS[0].goals) * 6 == 672
    assert not {maze.name for maze in TESTS} & {maze.name for maze in VALIDATION}


def test_a_folder_without_the_mazes_is_one_line(tmp_path):
    pytest.importorskip("vizdoom")
    with pytest.raises(SceneError, match="is no copy of github nsavinov/SPTM"):
        Game(tmp_path / "data", TESTS[0])


@found
def test_a_recording_of_a_goal_ends_near_the_goal_and_random_walks_begin_at_the_starts(monkeypatch):
    pytest.importorskip("vizdoom")
    monkeypatch.setattr(sptm, "STEPS", 40)
    maze = VALIDATION[1]
    game = Game(FOLDER / "data", maze)
    frames, places = game.replay(f"{maze.name}_{sptm.GOALS[1]}")
    assert frames.shape[1:] == (120, 160, 3)
    assert abs(places[-1] - maze.goals[1]).max() <= sptm.NEAR
    assert walk(game, STARTS[0], maze.goals[1], random_walker(0)) == (False, 40)
    assert tuple(game.see()[1].round()) != tuple(places[0].round())
    game.close()
