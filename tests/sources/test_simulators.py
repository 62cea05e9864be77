"""Scenes from simulators: a grid that a double walks on, the simulators themselves, and a double of AI2-THOR's."""

import os
import sys
from ctypes.util import find_library
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from field import Field
from refusals import refused

from dirl.scenes import read_dump, write_dump
from dirl.scenes.live import Dumped, Pose, Simulated, state_pose
from dirl.sources.miniworld import MiniWorld
from dirl.sources.simulators import take_scene
from dirl.sources.thor import Thor, start_controller
from dirl.sources.vizdoom import VizDoom


class Grid(Field):
    """An agent that walks on cells of a metre; a cell with ``one_way`` can be entered, but not left."""

    def __init__(self, cells, one_way=()):
        super().__init__()
        self.cells, self.one_way, self.pose = set(map(tuple, cells)), set(one_way), Pose(0.5, 0.5, 90.0)

    def is_free(self, pose):
        return (round(pose[0] - 0.5), round(pose[1] - 0.5)) in self.cells

    def push(self, metres):
        x, z, heading = self.pose
        end = x + metres * np.sin(np.radians(heading)), z + metres * np.cos(np.radians(heading))
        if not self.is_free(end) or (round(x - 0.5), round(z - 0.5)) in self.one_way:
            return False
        assert np.allclose(np.round(end, 3) % 1, 0.5), "a move that ends between places"
        self.pose = Pose(*end, heading)
        return True


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


@pytest.fixture
def miniworld():
    if not find_spec("miniworld"):  # importing it opens a window, unless `MiniWorld` does
        pytest.skip("the extra miniworld is not installed")
    if not find_library("EGL"):
        pytest.skip("the library EGL is missing (Debian: libegl1), without which nothing is drawn without a display")
    return MiniWorld("MazeS2", seed=1, height=60, width=80)


@pytest.fixture
def doom():
    pytest.importorskip("vizdoom", reason="the extra vizdoom is not installed")
    return VizDoom("map01", height=60, width=80)


@pytest.mark.parametrize(("kind", "step", "turn"), [("miniworld", 1.0, 45), ("doom", 3.0, 90)])
def test_a_walk_in_the_live_simulator_sees_the_views_of_its_dump(kind, step, turn, request, tmp_path):
    simulator, draws = request.getfixturevalue(kind), np.random.default_rng(0)
    write_dump(tmp_path / "live.h5", *take_scene(simulator, source=kind, step=step, turn=turn))
    scene = read_dump(tmp_path / "live.h5")
    small = np.stack([scene.views[state][::4, ::4] for state in range(len(scene))]).astype(np.int16)
    live, dumped, own = Simulated(simulator, step=step, turns=360 // turn), Dumped(scene), 0
    first = state_pose(scene, int(draws.integers(len(scene))))
    for world in (live, dumped):
        world.reset(first)
    for action in draws.choice(4, 40, p=(0.4, 0.2, 0.2, 0.2)).tolist():
        assert live.step(action) == dumped.step(action)
        assert np.allclose(live.pose[:2], dumped.pose[:2], atol=0.05)
        views = live.views()
        assert np.abs(views.astype(float) - dumped.views()).mean() < 8
        distance = np.abs(small - views[0, ::4, ::4]).mean((1, 2, 3))
        own += int(distance[dumped.state] == distance.min())
    assert own >= 38  # the view ahead is nearest to that of the dump's own state


@pytest.mark.usefixtures("miniworld")
def test_places_and_names_that_the_simulators_do_not_have(tmp_path, doom):
    refused("cannot be put at 9000", doom.place, Pose(9000.0, 0.0, 0.0))
    refused(r"MiniWorld: there is no environment 'FourRoms'; did you mean 'FourRooms'\?", MiniWorld, "FourRoms")
    refused(r"map=map99: freedoom2.wad holds no such map; it holds MAP01, ", VizDoom, "map99")
    Path(tmp_path / "x.wad").write_bytes(b"no")
    os.mkfifo(tmp_path / "pipe.wad")
    for name in ("x.wad", "pipe.wad"):
        refused(rf"{name}: not a readable WAD file", VizDoom, "map01", wad=str(tmp_path / name))


class AnsweringController:
    """A double of AI2-THOR's controller, with events as ai2thor 5.0 makes them; without a grid Unity is gone."""

    def __init__(self, grid=None):
        self.grid = grid

    def step(self, action, moveMagnitude=0.0, **pose):
        if not self.grid:
            raise RuntimeError(f"Error encountered when running action {action}\n in scene FloorPlan1.")
        message = ""
        if action == "Teleport":
            assert set(pose) == {"position", "rotation", "horizon", "standing"}
            to = Pose(pose["position"]["x"], pose["position"]["z"], pose["rotation"]["y"])
            if self.grid.is_free(to):
                self.grid.place(to)
            else:
                message = "Collided with: \nSink_3."
        elif action != "Pass" and not self.grid.push(moveMagnitude if action == "MoveAhead" else -moveMagnitude):
            message = "Wall is blocking Agent 0 from moving by (0.0000, 0.0000, 1.0000)."
        x, z, heading = np.array(self.grid.pose) + 3e-7  # its numbers are float32
        agent = {"position": {"x": x, "y": 0.9, "z": z}, "rotation": {"x": -0.0, "y": heading, "z": 0.0}}
        metadata = {"agent": agent, "lastActionSuccess": not message, "errorMessage": message}
        return SimpleNamespace(metadata=metadata, frame=self.grid.look(heading))


def test_the_controller_is_started_as_asked_and_its_failure_is_one_line(monkeypatch):
    asked = {}

    class Controller:
        def __init__(self, **arguments):
            asked.update(arguments)
            if arguments["scene"] == "FloorPlan0":
                raise ValueError("\nScene 'FloorPlan0' not contained in build.\nPlease choose one")

    settings = {"step": 0.5, "height": 300, "width": 400, "field_of_view": 75, "headless": True}
    monkeypatch.setitem(sys.modules, "ai2thor.controller", None)
    refused(r"AI2-THOR is not installed .*: pip install 'dirl\[thor\]'", start_controller, "FloorPlan1", **settings)
    for name, what in (("controller", {"Controller": Controller}), ("platform", {"CloudRendering": "the class"})):
        monkeypatch.setitem(sys.modules, f"ai2thor.{name}", SimpleNamespace(**what))
    assert isinstance(start_controller("FloorPlan1", **settings), Controller)
    fixed = {"snapToGrid": True, "rotateStepDegrees": 90, "gridSize": 0.5}
    camera = {"height": 300, "width": 400, "fieldOfView": 75, "platform": "the class"}
    assert asked == {"scene": "FloorPlan1", **fixed, **camera}
    told = r"scene=FloorPlan0: AI2-THOR does not start \(ValueError: Scene 'Fl"
    refused(told, start_controller, "FloorPlan0", **settings)


def test_it_is_walked_live():
    grid = Grid([(0, 0), (0, 1)])
    world = Simulated(Thor(AnsweringController(grid), "FloorPlan1"), step=1.0)
    world.reset(Pose(0.5, 0.5, 90.0))
    assert [world.step(action) for action in (0, 2, 0, 0)] == [False, True, True, False]  # towards a wall, left, on
    assert np.allclose(world.pose, (0.5, 1.5, 0.0), atol=1e-5)
    assert world.step(3)
    assert np.allclose(world.views(), [grid.look(heading) for heading in (0, 90, 180, 270)], atol=1)
    assert np.allclose(world.pose, (0.5, 0.5, 0.0), atol=1e-5)
    refused(r"FloorPlan1: .* put at 4\.00, 0\.00 m: Collided with: Sink_3", world.reset, Pose(4.0, 0.0, 0.0))
    refused("FloorPlan1: AI2-THOR failed", Thor, AnsweringController(), "FloorPlan1")
