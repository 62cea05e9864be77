"""Taking a scene from live AI2-THOR, here from a double of its controller."""

import json

import numpy as np
import pytest
from simulator import Simulator

from dirl.scenes import SceneError
from dirl.scenes.live import Pose, Simulated
from dirl.sources.photos import read_photos
from dirl.sources.thor import Thor, start_simulator, take_views

CELLS = [(-2, 1), (-1, 1), (0, 1), (-1, 2), (0, 2)]
SETTINGS = {"scene": "FloorPlan1", "step": 0.5, "height": 300, "width": 400}


def take(folder, simulator=None, **settings):
    return take_views(simulator or Simulator(CELLS), folder, settings=SETTINGS | settings)


def test_a_scene_is_what_the_simulator_allows(tmp_path):
    assert take(tmp_path) == []
    scene, images = read_photos(tmp_path, name="FloorPlan1", source="thor")
    assert len(scene) == len(images) == 20
    assert scene.headings.tolist() == [0, 90, 180, 270] * 5
    cells = {
        tuple((2 * position).round().astype(int)): 4 * place for place, position in enumerate(scene.positions[::4])
    }
    assert set(cells) == set(CELLS)
    for (x, z), first in cells.items():
        for turn, (dx, dz) in enumerate([(0, 1), (1, 0), (0, -1), (-1, 0)]):
            ahead, back = cells.get((x + dx, z + dz)), cells.get((x - dx, z - dz))
            assert scene.graph[first + turn, 0] == (-1 if ahead is None else ahead + turn)
            assert scene.graph[first + turn, 3] == (-1 if back is None else back + turn)


def test_every_frame_is_taken_before_the_first_move(tmp_path):
    simulator = Simulator(CELLS)
    take(tmp_path, simulator)
    assert simulator.calls == [
        "GetReachablePositions",
        *["Teleport"] * 20,
        *["Teleport", "MoveAhead", "Teleport", "MoveBack"] * 20,
    ]


@pytest.mark.parametrize("crash_after", [1, 9, 20, 23, 24, 70])
def test_a_crash_is_told_and_gone_on_from(tmp_path, crash_after):
    with pytest.raises(SceneError, match=r"AI2-THOR failed \(.* FloorPlan1\.\); the same command continues from here"):
        take(tmp_path / "a", Simulator(CELLS, crash_after=crash_after))
    assert not (tmp_path / "a" / "states.csv").exists()
    again = Simulator(CELLS)
    take(tmp_path / "a", again)
    assert len(again.calls) <= 1 + 100 - (crash_after - 1) + 3  # at most one state is done twice
    take(tmp_path / "b")
    assert (tmp_path / "a" / "states.csv").read_text() == (tmp_path / "b" / "states.csv").read_text()
    for image in (tmp_path / "b" / "images").iterdir():
        assert (tmp_path / "a" / "images" / image.name).read_bytes() == image.read_bytes()


def test_what_is_finished_is_not_asked_for_again(tmp_path):
    take(tmp_path)
    again = Simulator(CELLS)
    take(tmp_path, again)
    assert again.calls == ["GetReachablePositions"]


def test_a_row_cut_off_by_a_kill_is_done_again(tmp_path):
    take(tmp_path)
    whole = (tmp_path / "states.csv").read_text()
    moves = tmp_path / "moves.csv"
    moves.write_text(moves.read_text()[:-9])
    again = Simulator(CELLS)
    take(tmp_path, again)
    assert again.calls[1:] == ["Teleport", "MoveAhead", "Teleport", "MoveBack"]
    assert (tmp_path / "states.csv").read_text() == whole


def test_positions_where_the_agent_cannot_stand_are_left_out_and_told(tmp_path):
    left_out = take(tmp_path, Simulator(CELLS, nowhere=[(0, 1)]))
    assert left_out == ["0.00_0.50: Collided with: Sink_3."]
    scene, _ = read_photos(tmp_path)
    assert len(scene) == 16
    assert (scene.graph[:, [0, 3]] < 16).all()


@pytest.mark.parametrize(
    ("simulator", "settings", "says"),
    [
        (Simulator(CELLS, nowhere=CELLS), {}, "FloorPlan1: the agent can stand at none of the 5 reachable positions"),
        (
            Simulator(CELLS, shape=(300, 300)),
            {},
            r"position -1\.00_0\.50, heading 0: .* gives a frame uint8 \(300, 300, 3",
        ),
    ],
)
def test_what_cannot_be_taken_is_refused(tmp_path, simulator, settings, says):
    with pytest.raises(SceneError, match=says):
        take(tmp_path, simulator, **settings)


def test_a_frame_of_one_colour_means_that_nothing_is_rendered(tmp_path, monkeypatch):
    simulator = Simulator(CELLS)
    frame = simulator.frame() * 0
    monkeypatch.setattr(simulator, "frame", lambda: frame)
    with pytest.raises(SceneError, match=r"heading 0: the frame is of one colour: .* use headless=true"):
        take(tmp_path, simulator)


def test_a_scene_without_reachable_positions_is_refused(tmp_path, monkeypatch):
    simulator = Simulator(CELLS)
    simulator.cells = []
    simulator.cell = (0, 0)
    with pytest.raises(SceneError, match="FloorPlan1: AI2-THOR finds no reachable positions"):
        take(tmp_path, simulator)


@pytest.mark.parametrize(("key", "value"), [("scene", "FloorPlan2"), ("step", 0.25), ("height", 224)])
def test_a_folder_is_gone_on_with_only_by_the_same_settings(tmp_path, key, value):
    take(tmp_path)
    before = json.loads((tmp_path / "plan.json").read_text())
    with pytest.raises(SceneError, match=f"was begun with another {key}; delete the folder"):
        take(tmp_path, **{key: value})
    assert json.loads((tmp_path / "plan.json").read_text()) == before


def test_without_ai2thor_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "ai2thor.controller", None)
    with pytest.raises(SceneError, match=r"AI2-THOR is not installed .*: pip install 'dirl\[thor\]'"):
        start_simulator("FloorPlan1", step=0.5, height=300, width=400, field_of_view=90, headless=True)


@pytest.mark.parametrize("headless", [False, True])
def test_the_controller_is_started_as_asked_and_its_failure_is_one_line(monkeypatch, headless):
    from types import ModuleType

    asked = {}

    class Controller:
        def __init__(self, **arguments):
            asked.update(arguments)
            if arguments["scene"] == "FloorPlan0":
                raise ValueError("\nScene 'FloorPlan0' not contained in build.\nPlease choose one")

    names = ("ai2thor", "ai2thor.controller", "ai2thor.platform")
    package, controller, platform = (ModuleType(name) for name in names)
    controller.Controller, platform.CloudRendering = Controller, "the class"
    for name, module in zip(names, (package, controller, platform), strict=True):
        monkeypatch.setitem(__import__("sys").modules, name, module)
    size = {"height": 300, "width": 400}
    settings = {"step": 0.5, **size, "field_of_view": 75, "headless": headless}
    assert isinstance(start_simulator("FloorPlan1", **settings), Controller)
    fixed = {
        "snapToGrid": True,
        "rotateStepDegrees": 90,
        "gridSize": 0.5,
        "height": 300,
        "width": 400,
        "fieldOfView": 75,
    }
    assert asked == fixed | {"scene": "FloorPlan1"} | ({"platform": "the class"} if headless else {})
    with pytest.raises(SceneError, match=r"scene=FloorPlan0: AI2-THOR does not start \(ValueError: Scene 'Fl"):
        start_simulator("FloorPlan0", **settings)


def test_it_is_walked_live():
    world = Simulated(Thor(Simulator([(0, 0), (0, 1)]), "FloorPlan1"), step=0.5)
    world.reset(Pose(0.0, 0.0, 90.0))
    assert [world.step(action) for action in (0, 2, 0, 0)] == [False, True, True, False]  # towards a wall, left, on
    assert np.allclose(world.pose, (0.0, 0.5, 0.0), atol=1e-5)
    assert world.views()[:, -1, 0, 1].tolist() == [0, 60, 120, 180]  # the double's colour of each heading
    assert np.allclose(world.pose, (0.0, 0.5, 0.0), atol=1e-5)
    with pytest.raises(SceneError, match=r"FloorPlan1: .* put at 4\.00, 0\.00 m: Collided with: Sink_3"):
        world.reset(Pose(4.0, 0.0, 0.0))
    with pytest.raises(SceneError, match="FloorPlan1: AI2-THOR failed"):
        Thor(Simulator([(0, 0)], crash_after=0), "FloorPlan1")
