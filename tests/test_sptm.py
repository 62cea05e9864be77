"""SPTM's protocol: an episode in a maze, and the report of all."""

from pathlib import Path

import mazes
import numpy as np
import pytest
import sptm
from refusals import refused
from sptm import AHEAD, IDLE, STARTS, STEPS, TESTS, VALIDATION, Game, Maze, Player, map_walkthrough, walk

from dirl.agent.mapping.guide import Guide

SETTINGS = """screen_resolution = RES_160X120
render_hud = false
render_weapon = false
render_crosshair = false
available_buttons = { MOVE_LEFT MOVE_RIGHT MOVE_FORWARD MOVE_BACKWARD TURN_LEFT TURN_RIGHT }
available_game_variables = { POSITION_X POSITION_Y ANGLE }
game_args += +cl_run 1
"""


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


def test_an_episode_of_672_ends_within_63_units_or_after_5000_steps():
    assert len(TESTS) * len(STARTS) * len(TESTS[0].goals) * 6 == 672
    assert not {maze.name for maze in TESTS} & {maze.name for maze in VALIDATION}
    assert walk(Straight(), "map02", (500, 0), lambda frame: AHEAD) == (True, 44)  # at 440 units
    assert walk(Straight(), "map02", (500, 0), lambda frame: IDLE) == (False, STEPS)
    assert walk(Straight(), "map02", (63, 0), lambda frame: IDLE) == (True, 0)


def test_a_folder_without_the_mazes_is_one_line(tmp_path):
    pytest.importorskip("vizdoom")
    refused("is no copy of github nsavinov/SPTM", Game, tmp_path / "data", TESTS[0])


@pytest.mark.parametrize("use", [lambda game: game.see(), lambda game: game.act(AHEAD)])
def test_a_game_that_is_gone_is_one_line(use):
    game = Game.__new__(Game)
    game._buttons, game._game = [], None  # its process was killed
    refused(r"^VizDoom failed \(AttributeError: .*\); run the command again$", use, game)


def test_a_follower_goes_where_a_walk_through_a_corridor_of_our_own_went(tmp_path, monkeypatch):
    vizdoom = pytest.importorskip("vizdoom")
    monkeypatch.setattr(sptm, "STEPS", 800)
    right = np.zeros((7, 1), bool)
    right[-1] = True
    folder = tmp_path / "Val" / "own"
    folder.mkdir(parents=True)
    iwad = Path(vizdoom.__file__).parent / "freedoom2.wad"
    plan = mazes.Maze(right, np.ones((7, 1), bool))
    # From this seed the player looks along the corridor, from one end.
    mazes.write_mazes(folder / "own.wad_manymaps_test.wad", [plan], iwad, np.random.default_rng(17))
    (tmp_path / "default.cfg").write_text(SETTINGS)
    game = Game(tmp_path, Maze("Val/own", ()))
    game.start("map01")
    frames, places = [], []
    for action in [AHEAD, IDLE] * 9:
        frame, place = game.see()
        frames.append(frame)
        places.append(place)
        game.act(action)
    assert np.hypot(*(places[-1] - places[0])) > 250
    graph = map_walkthrough(np.repeat(frames, 4, 0))
    guides = [Player(Guide(graph, [frames[-1]]), seed) for seed in range(3)]
    reached = [walk(game, "map01", tuple(places[-1]), player.act)[0] for player in guides]
    game.close()
    assert all(reached)


def test_the_report_walks_each_maze_in_a_process_of_its_own_and_keeps_what_is_finished(tmp_path, monkeypatch):
    monkeypatch.setattr(sptm, "TESTS", (Maze("Test/own", ()), Maze("Test/other", ())))
    monkeypatch.setattr(sptm, "check_files", lambda data, maze: data)
    monkeypatch.setattr(sptm, "in_processes", lambda tasks, workers, name: (task() for task in tasks))
    walked = []

    def walk_maze(data, maze, name, trials):
        walked.append((maze.name, name, trials))
        return [(name == sptm.MEMORY, 400)] * 16 * trials

    monkeypatch.setattr(sptm, "walk_maze", walk_maze)
    text = sptm.report_sptm(tmp_path, 2, tmp_path / "out", workers=2)
    assert len(set(walked)) == len(walked) == 6
    assert f"| all | {sptm.MEMORY} | 1.00 | 400 | 64 |" in text
    assert f"| all | {sptm.BLIND} | 0.00 |" in text
    assert sptm.report_sptm(tmp_path, 2, tmp_path / "out", workers=2) == text
    assert len(walked) == 6
