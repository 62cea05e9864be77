"""Taking a scene from live AI2-THOR, here from a double of its controller."""

import sys
from types import ModuleType, SimpleNamespace

import numpy as np
from refusals import refused

from dirl.scenes.live import Pose, Simulated
from dirl.sources.thor import Thor, start_controller

ALONG = {0: (0, 1), 90: (1, 0), 180: (0, -1), 270: (-1, 0)}
NOISE = 3e-7
"""AI2-THOR's numbers are float32."""


class Simulator:
    """A double of the controller: it answers `step` with events as ai2thor 5.0 makes them, of a room on a grid.

    Args:
        cells: free cells (x, z), as multiples of the step, half a metre.
        gone: raise as the controller does when Unity is gone.
    """

    def __init__(self, cells, gone=False):
        self.cells, self.gone, self.cell, self.heading = list(cells), gone, cells[0], 90

    def step(self, action, **arguments):
        if self.gone:
            raise RuntimeError(f"Error encountered when running action {action}\n in scene FloorPlan1.")
        message = ""
        if action == "Teleport":
            assert set(arguments) == {"position", "rotation", "horizon", "standing"}
            cell = tuple(round(2 * arguments["position"][axis]) for axis in "xz")
            if cell in self.cells:
                self.cell, self.heading = cell, round(arguments["rotation"]["y"])
            else:
                message = "Collided with: \nSink_3."
        elif action in ("MoveAhead", "MoveBack"):
            sign = 1 if action == "MoveAhead" else -1
            to = tuple(at + sign * by for at, by in zip(self.cell, ALONG[self.heading], strict=True))
            if to in self.cells:
                self.cell = to
            else:
                message = "Wall is blocking Agent 0 from moving by (0.0000, 0.0000, 0.5000)."
        else:
            assert action == "Pass", f"Invalid action: {action}"
        at = {"x": self.cell[0] / 2 - NOISE, "y": 0.9009991884231567, "z": self.cell[1] / 2 + NOISE}
        agent = {"position": at, "rotation": {"x": -0.0, "y": self.heading + NOISE, "z": 0.0}}
        metadata = {"agent": agent, "lastActionSuccess": not message, "errorMessage": message}
        frame = np.full((3, 4, 3), 60 * (self.heading // 90), np.uint8)
        frame[2, 3] += 9  # what is of one colour would be refused
        return SimpleNamespace(metadata=metadata, frame=frame)


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
    names = ("ai2thor", "ai2thor.controller", "ai2thor.platform")
    package, controller, platform = (ModuleType(name) for name in names)
    controller.Controller, platform.CloudRendering = Controller, "the class"
    for name, module in zip(names, (package, controller, platform), strict=True):
        monkeypatch.setitem(sys.modules, name, module)
    assert isinstance(start_controller("FloorPlan1", **settings), Controller)
    fixed = {"snapToGrid": True, "rotateStepDegrees": 90, "gridSize": 0.5}
    camera = {"height": 300, "width": 400, "fieldOfView": 75, "platform": "the class"}
    assert asked == {"scene": "FloorPlan1", **fixed, **camera}
    told = r"scene=FloorPlan0: AI2-THOR does not start \(ValueError: Scene 'Fl"
    refused(told, start_controller, "FloorPlan0", **settings)


def test_it_is_walked_live():
    world = Simulated(Thor(Simulator([(0, 0), (0, 1)]), "FloorPlan1"), step=0.5)
    world.reset(Pose(0.0, 0.0, 90.0))
    assert [world.step(action) for action in (0, 2, 0, 0)] == [False, True, True, False]  # towards a wall, left, on
    assert np.allclose(world.pose, (0.0, 0.5, 0.0), atol=1e-5)
    assert world.step(3)
    assert np.allclose(world.pose, (0.0, 0.0, 0.0), atol=1e-5)
    assert world.views()[:, 0, 0, 0].tolist() == [0, 60, 120, 180]  # the double's colour of each heading
    assert np.allclose(world.pose, (0.0, 0.0, 0.0), atol=1e-5)
    refused(r"FloorPlan1: .* put at 4\.00, 0\.00 m: Collided with: Sink_3", world.reset, Pose(4.0, 0.0, 0.0))
    refused("FloorPlan1: AI2-THOR failed", Thor, Simulator([(0, 0)], gone=True), "FloorPlan1")
