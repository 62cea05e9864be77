"""Scenes from live AI2-THOR."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dirl.scenes.live import Pose, simulator_errors
from dirl.scenes.scene import SceneError


def start_controller(scene: str, *, step: float, height: int, width: int, field_of_view: float, headless: bool) -> Any:
    """Return a controller of AI2-THOR with the agent in a scene; its build is downloaded when it is first used.

    Neighbouring positions are a ``step`` of metres apart, frames are of so many pixels, and see so many degrees from
    top to bottom. A ``headless`` one needs no display.

    Raises:
        SceneError: AI2-THOR is not installed, does not start, or does not have the scene.
    """
    try:
        from ai2thor.controller import Controller as Started
        from ai2thor.platform import CloudRendering
    except ImportError as error:
        raise SceneError(f"AI2-THOR is not installed ({error}): pip install 'dirl[thor]'") from None
    platform = {"platform": CloudRendering} if headless else {}
    try:
        return Started(
            scene=scene,
            gridSize=step,
            snapToGrid=True,
            rotateStepDegrees=90,
            height=height,
            width=width,
            fieldOfView=field_of_view,
            **platform,
        )
    except Exception as error:  # it raises bare ones: no build, no display, no such scene
        reason = " ".join(str(error).split())[:300]
        hint = "" if headless else "; on a machine without a display: headless=true"
        raise SceneError(f"scene={scene}: AI2-THOR does not start ({type(error).__name__}: {reason}){hint}") from None


class Thor:
    """A controller with the agent in a scene, such as ``FloorPlan401``, as a `dirl.scenes.live.Simulator`.

    Of its ``step`` are used ``Pass``, ``Teleport``, ``MoveAhead`` and ``MoveBack``, and of their events the frame, RGB,
    uint8 ``[H, W, 3]``, and the metadata ``agent``, ``lastActionSuccess`` and ``errorMessage``.
    """

    def __init__(self, controller: Any, scene: str) -> None:
        self.name, self._controller = scene, controller
        with simulator_errors(f"{scene}: AI2-THOR"):
            event = controller.step("Pass")
        self._agent, self._frame = event.metadata["agent"], event.frame

    @property
    def pose(self) -> Pose:
        """Where the agent is."""
        at = self._agent["position"]
        return Pose(at["x"], at["z"], self._agent["rotation"]["y"] % 360)

    def push(self, metres: float) -> bool:
        """Walk along the heading, backwards if negative; where blocked the agent stays where it was."""
        with simulator_errors(f"{self.name}: AI2-THOR"):
            event = self._controller.step("MoveAhead" if metres > 0 else "MoveBack", moveMagnitude=abs(metres))
        self._agent = event.metadata["agent"]
        return bool(event.metadata["lastActionSuccess"])

    def look(self, heading: float) -> NDArray[np.uint8]:
        """Return the view towards a heading."""
        pose = self.pose
        self.place(pose._replace(heading=heading))
        frame = np.array(self._frame)
        self.place(pose)
        if frame.min() == frame.max():
            raise SceneError(
                f"{self.name}: the frame is of one colour: nothing is rendered; check the display, or use headless=true"
            )
        return frame

    def place(self, pose: Pose) -> None:
        """Put the agent somewhere, `SceneError` where it cannot stand."""
        position = {**self._agent["position"], "x": pose.x, "z": pose.z}
        turned = {"x": 0.0, "y": float(pose.heading), "z": 0.0}
        problem = ""
        with simulator_errors(f"{self.name}: AI2-THOR"):
            event = self._controller.step("Teleport", position=position, rotation=turned, horizon=0.0, standing=True)
            agent = event.metadata["agent"]
            off = max(abs(agent["position"][axis] - position[axis]) for axis in "xz")
            turn = abs((agent["rotation"]["y"] - pose.heading + 180) % 360 - 180)
            if not event.metadata["lastActionSuccess"]:
                problem = " ".join(str(event.metadata["errorMessage"]).split())[:200] or "Teleport failed"
            elif off > 0.02 or turn > 1:
                problem = f"Teleport left the agent {off:.2f} m and {turn:.0f} degrees off"
        if problem:
            raise SceneError(f"{self.name}: the agent cannot be put at {pose.x:.2f}, {pose.z:.2f} m: {problem}")
        self._agent, self._frame = agent, event.frame
