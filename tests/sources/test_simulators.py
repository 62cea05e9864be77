"""Scenes from simulators: a grid that a double walks on, and the simulators themselves."""

import os
from ctypes.util import find_library
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from refusals import refused

from dirl.config.files import load_simulator
from dirl.scenes import read_dump, write_dump
from dirl.scenes.live import Dumped, Pose, Simulated, state_pose
from dirl.sources.miniworld import MiniWorld
from dirl.sources.simulators import take_scene
from dirl.sources.vizdoom import VizDoom


class Grid:
    """A simulator whose agent walks on cells of a metre; a cell with ``one_way`` can be entered, but not left."""

    name = "grid"

    def __init__(self, cells, one_way=()):
        self.cells, self.one_way, self.pose = set(map(tuple, cells)), set(one_way), Pose(0.5, 0.5, 90.0)

    def place(self, pose):
        self.pose = pose

    def push(self, metres):
        radians = np.radians(self.pose.heading)
        x, z = self.pose.x + metres * np.sin(radians), self.pose.z + metres * np.cos(radians)
        here = (round(self.pose.x - 0.5), round(self.pose.z - 0.5))
        there = (round(x - 0.5), round(z - 0.5))
        if there not in self.cells or here in self.one_way:
            return False
        assert np.allclose((x - 0.5, z - 0.5), there), "a move that ends between places"
        self.pose = Pose(x, z, self.pose.heading)
        return True

    def look(self, heading):
        return np.full((16, 16, 3), heading / 360 * 255, np.uint8)


@pytest.mark.parametrize(("turn", "diagonal"), [(90, False), (45, True), (30, False)])
def test_places_are_those_that_can_be_walked_to_and_fro(turn, diagonal):
    scene, views = take_scene(Grid([(0, 0), (1, 0), (1, 1), (0, -1)], [(0, -1)]), source="x", step=1.0, turn=turn)
    turns = 360 // turn
    assert {tuple(place) for place in scene.positions} == {(0.5, 0.5), (1.5, 0.5), (1.5, 1.5)}  # there is no way back
    assert len(scene) == len(views) == 3 * turns
    moves = {
        (*scene.positions[state], scene.headings[state], *scene.positions[after])
        for state, after in enumerate(scene.graph[:, 0])
        if after >= 0
    }
    along = {(0.5, 0.5, 90, 1.5, 0.5), (1.5, 0.5, 270, 0.5, 0.5), (1.5, 0.5, 0, 1.5, 1.5), (1.5, 1.5, 180, 1.5, 0.5)}
    askew = {(0.5, 0.5, 45, 1.5, 1.5), (1.5, 1.5, 225, 0.5, 0.5)}
    assert moves == (along | askew if diagonal else along)
    back = [(state, after) for state, after in enumerate(scene.graph[:, 3]) if after >= 0]
    assert len(back) == len(moves)
    assert all(scene.graph[after, 0] == state for state, after in back)


def test_no_more_places_than_asked_for_and_the_nearest_and_what_makes_no_scene_is_one_line():
    scene, _ = take_scene(Grid([(x, 0) for x in range(9)]), source="x", step=1.0, turn=90, most=3)
    assert scene.positions[::4, 0].tolist() == [0.5, 1.5, 2.5]
    refused("no move of 1 m leads anywhere and back", take_scene, Grid([(0, 0)]), source="x", step=1.0, turn=90)
    refused("turn=50: a turn must go into 90", take_scene, Grid([(0, 0), (1, 0)]), source="x", step=1.0, turn=50)


def test_a_simulator_is_made_of_its_file_or_refused_in_one_line(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text(f"_target_: {__name__}.Grid\ncells: [[0, 0], [1, 0]]\n")
    assert load_simulator(str(file)).pose == Pose(0.5, 0.5, 90.0)
    wrong = {
        f"_target_: {__name__}.Nope": "there is no such class",
        f"_target_: {__name__}.Grid\ncells: [[0, 0]]\nspeed: 3": "no option 'simulator.speed'",
        "_target_: pathlib.PurePath": "has no method place, which every simulator has",
    }
    for text, message in wrong.items():
        file.write_text(text)
        refused(message, load_simulator, str(file))


def walk(simulator, scene, step, turns, moves):
    """Random moves in the live world and in its dump, from a random state.

    Returns: the blocked moves that differ; the largest distance between the two, metres; of each step the mean
    difference of the views, of 255; and in how many steps the view ahead is nearest to that of the dump's own state.
    """
    live, dumped = Simulated(simulator, step=step, turns=turns), Dumped(scene)
    small = np.stack([scene.views[state][::4, ::4] for state in range(len(scene))]).astype(np.int16)
    draws = np.random.default_rng(0)
    first = state_pose(scene, int(draws.integers(len(scene))))
    for world in (live, dumped):
        world.reset(first)
    differ, off, apart, own = 0, [], 0.0, 0
    for action in draws.choice(4, moves, p=(0.4, 0.2, 0.2, 0.2)).tolist():
        differ += live.step(action) != dumped.step(action)
        apart = max(apart, float(np.hypot(*np.subtract(live.pose[:2], dumped.pose[:2]))))
        views = live.views()
        off.append(float(np.abs(views.astype(float) - dumped.views()).mean()))
        distance = np.abs(small - views[0, ::4, ::4]).mean((1, 2, 3))
        own += int(distance[dumped.state] == distance.min())
    return differ, apart, off, own


@pytest.fixture
def miniworld():
    if not find_spec("miniworld"):  # importing it opens a window, unless `MiniWorld` does
        pytest.skip("the extra miniworld is not installed")
    if not find_library("EGL"):
        pytest.skip("the library EGL is missing (Debian: libegl1), without which nothing is drawn without a display")
    return MiniWorld("MazeS3", seed=1, height=60, width=80)


@pytest.fixture
def doom():
    pytest.importorskip("vizdoom", reason="the extra vizdoom is not installed")
    return VizDoom("map01", height=60, width=80)


@pytest.mark.parametrize(("kind", "step", "turn"), [("miniworld", 1.0, 45), ("doom", 2.0, 90)])
def test_a_walk_in_the_live_simulator_sees_the_views_of_its_dump(kind, step, turn, request, tmp_path):
    simulator = request.getfixturevalue(kind)
    scene, views = take_scene(simulator, source=kind, step=step, turn=turn)
    write_dump(tmp_path / "live.h5", scene, views)
    differ, apart, off, own = walk(simulator, read_dump(tmp_path / "live.h5"), step, 360 // turn, 60)
    assert differ == 0
    assert apart < 0.05
    assert max(off) < 8
    assert own >= 58


@pytest.mark.usefixtures("miniworld")
def test_places_and_names_that_the_simulators_do_not_have(tmp_path, doom):
    refused("cannot be put at 9000", doom.place, Pose(9000.0, 0.0, 0.0))
    refused(r"MiniWorld: there is no environment 'FourRoms'; did you mean 'FourRooms'\?", MiniWorld, "FourRoms")
    refused(r"map=map99: freedoom2.wad holds no such map; it holds MAP01, ", VizDoom, "map99")
    Path(tmp_path / "x.wad").write_bytes(b"no")
    os.mkfifo(tmp_path / "pipe.wad")
    for name in ("x.wad", "pipe.wad"):
        refused(rf"{name}: not a readable WAD file", VizDoom, "map01", wad=str(tmp_path / name))
