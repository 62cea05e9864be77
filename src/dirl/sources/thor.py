"""Scenes from live AI2-THOR: every reachable position with four headings, as frames and attempted moves.

Frames and moves are stored in a folder as `dirl.sources.photos` reads it, so that a stopped run can continue.
"""

import csv
import json
from collections.abc import Mapping
from contextlib import AbstractContextManager
from itertools import product
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from dirl.scenes.io.atomic import atomic_path
from dirl.scenes.live import Pose, simulator_errors
from dirl.scenes.scene import SceneError
from dirl.scenes.views import encode
from dirl.sources.photos import write_table
from dirl.sources.simulators import QUALITY

HEADINGS = (0, 90, 180, 270)
"""Degrees clockwise from +z, AI2-THOR's rotation about y."""

PLAN, MOVES = "plan.json", "moves.csv"


class Simulator(Protocol):
    """The part of the interface of ``ai2thor.controller.Controller`` that is used.

    An event has ``frame``, uint8 ``[H, W, 3]``, and ``metadata``, of which are read ``lastActionSuccess``,
    ``errorMessage``, ``actionReturn`` and ``agent`` (``position`` and ``rotation``, each with ``x``, ``y``, ``z``).
    """

    def step(self, action: str, **arguments: Any) -> Any:
        """Execute an action; returns an event."""


def start_simulator(
    scene: str, *, step: float, height: int, width: int, field_of_view: float, headless: bool
) -> Simulator:
    """A controller of AI2-THOR with the agent in a scene; its build is downloaded when it is first used.

    Args:
        scene: e.g. ``FloorPlan401``.
        step: metres between neighbouring positions.
        height: of a frame, pixels.
        width: of a frame, pixels.
        field_of_view: vertical, degrees.
        headless: render without a display.

    Raises:
        SceneError: AI2-THOR is not installed, does not start, or does not have the scene.
    """
    try:
        from ai2thor.controller import Controller
        from ai2thor.platform import CloudRendering
    except ImportError as error:
        raise SceneError(f"AI2-THOR is not installed ({error}): pip install 'dirl[thor]'") from None
    platform = {"platform": CloudRendering} if headless else {}
    try:
        return Controller(
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
    """A controller with the agent in a scene, such as ``FloorPlan401``, as a `dirl.scenes.live.Simulator`."""

    def __init__(self, controller: Simulator, scene: str) -> None:
        self.name, self._controller = scene, controller
        with _simulator_errors(scene):
            self._agent = controller.step("GetReachablePositions").metadata["agent"]

    @property
    def pose(self) -> Pose:
        """Where the agent is."""
        at = self._agent["position"]
        return Pose(at["x"], at["z"], self._agent["rotation"]["y"] % 360)

    def push(self, metres: float) -> bool:
        """Walk along the heading, backwards if negative; where blocked the agent stays where it was."""
        with _simulator_errors(self.name):
            event = self._controller.step("MoveAhead" if metres > 0 else "MoveBack", moveMagnitude=abs(metres))
        self._agent = event.metadata["agent"]
        return bool(event.metadata["lastActionSuccess"])

    def look(self, heading: float) -> NDArray[np.uint8]:
        """The view towards a heading."""
        pose = self.pose
        frame = np.array(self.place(pose._replace(heading=heading)).frame)
        self.place(pose)
        return frame

    def place(self, pose: Pose) -> Any:
        """Put the agent somewhere, `SceneError` where it cannot stand; returns AI2-THOR's event."""
        position = {**self._agent["position"], "x": pose.x, "z": pose.z}
        with _simulator_errors(self.name):
            event, problem = _teleport(self._controller, position, pose.heading)
        if problem:
            raise SceneError(f"{self.name}: the agent cannot be put at {pose.x:.2f}, {pose.z:.2f} m: {problem}")
        self._agent = event.metadata["agent"]
        return event


def take_views(simulator: Simulator, folder: Path, *, settings: Mapping[str, Any]) -> list[str]:
    """Take a frame in every state of the simulator's scene, try every move, and write ``states.csv``.

    All frames are taken before the first move, which may push things about.

    Args:
        simulator: with the agent in the scene.
        folder: for frames and moves; those that it has are not taken again.
        settings: ``scene``, ``step``, ``height`` and ``width`` as the simulator was started with, and whatever else
            must be the same to continue in a folder.

    Returns:
        The positions that are left out, each with the reason.

    Raises:
        SceneError: the folder is that of another scene or other settings, or the simulator fails. The message names
            the position.
    """
    with _simulator_errors(str(settings["scene"])):
        places = _reachable(simulator, str(settings["scene"]))
    _check_plan(folder, {**settings, "positions": list(places)})
    left_out = _take_frames(simulator, folder, places, (settings["height"], settings["width"]))
    kept = {name: position for name, position in places.items() if name not in left_out}
    if not kept:
        raise SceneError(f"{settings['scene']}: the agent can stand at none of the {len(places)} reachable positions")
    moves = _try_moves(simulator, folder, kept, str(settings["scene"]), float(settings["step"]))
    rows: list[dict[str, object]] = []
    for name, heading in product(kept, HEADINGS):
        at = {"image": _image(name, heading), "location": name, "heading": heading}
        # A position where the agent could stand in an earlier run, but not in this one, is no place to go.
        ahead, back = (end if end in kept else "" for end in moves[name, heading])
        rows.append({**at, "x": kept[name]["x"], "z": kept[name]["z"], "ahead": ahead, "back": back})
    write_table(folder, rows)
    return [f"{name}: {reason}" for name, reason in left_out.items()]


Position = dict[str, float]
"""Metres: ``x`` and ``z`` on the floor, ``y`` above it."""


def _reachable(simulator: Simulator, scene: str) -> dict[str, Position]:
    """All positions that the agent can walk to, by a name for each, in order of x and z."""
    metadata = simulator.step("GetReachablePositions").metadata
    positions = metadata["actionReturn"]
    if not metadata["lastActionSuccess"] or not positions:
        raise SceneError(f"{scene}: AI2-THOR finds no reachable positions ({metadata['errorMessage'] or 'none'})")
    # Rounding removes the float32 noise of coordinates from the name; adding zero makes -0.0 positive.
    rounded = [{"y": p["y"], **{axis: round(p[axis], 3) + 0.0 for axis in "xz"}} for p in positions]
    return {f"{p['x']:.2f}_{p['z']:.2f}": p for p in sorted(rounded, key=lambda p: (p["x"], p["z"]))}


def _check_plan(folder: Path, plan: dict[str, Any]) -> None:
    """Write the settings to the folder, or compare them with those of the folder's earlier run."""
    file = folder / PLAN
    if not file.is_file():
        (folder / "images").mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps(plan))
        return
    before = json.loads(file.read_text())
    other = [key for key in plan if before.get(key) != plan[key]]
    if other:
        raise SceneError(
            f"{folder}: was begun with another {other[0]}; delete the folder to begin anew, or choose another out"
        )


def _take_frames(
    simulator: Simulator, folder: Path, places: dict[str, Position], shape: tuple[int, int]
) -> dict[str, str]:
    """Write the frames that the folder lacks; returns the positions where the agent cannot stand, with the reason."""
    left_out: dict[str, str] = {}
    for name, heading in tqdm([*product(places, HEADINGS)], desc="frames", disable=None):
        file, where = folder / _image(name, heading), f"position {name}, heading {heading}"
        if file.is_file() or name in left_out:
            continue
        with _simulator_errors(where):
            event, problem = _teleport(simulator, places[name], heading)
        if problem:
            left_out[name] = problem
            continue
        frame = np.asarray(event.frame)
        _check_frame(frame, shape, where)
        with atomic_path(file) as unfinished:
            unfinished.write_bytes(encode(frame, QUALITY))
    return left_out


def _check_frame(frame: NDArray[Any], shape: tuple[int, int], where: str) -> None:
    if frame.dtype != np.uint8 or frame.shape != (*shape, 3):
        raise SceneError(f"{where}: AI2-THOR gives a frame {frame.dtype} {frame.shape}, asked was uint8 {(*shape, 3)}")
    if frame.min() == frame.max():
        raise SceneError(
            f"{where}: the frame is of one colour: nothing is rendered; check the display, or use headless=true"
        )


def _try_moves(
    simulator: Simulator, folder: Path, places: dict[str, Position], scene: str, step: float
) -> dict[tuple[str, int], tuple[str, str]]:
    """Where moves ahead and back lead from each position with each heading, empty = blocked."""
    file = folder / MOVES
    moves = _moves_so_far(file)
    with file.open("a", newline="") as stream:
        writer = csv.writer(stream)
        for name, heading in tqdm([*product(places, HEADINGS)], desc="moves", disable=None):
            if (name, heading) in moves:
                continue
            where, ends = f"position {name}, heading {heading}", []
            for action in ("MoveAhead", "MoveBack"):
                with _simulator_errors(f"{where}, {action}"):
                    _, problem = _teleport(simulator, places[name], heading)
                    if problem:  # it has been there before, for the frame
                        raise SceneError(f"{scene}: {where}: {problem}; run it again")
                    metadata = simulator.step(action).metadata
                end = _place_at(metadata, places, step) if metadata["lastActionSuccess"] else ""
                ends.append("" if end == name else end)
            moves[name, heading] = (ends[0], ends[1])
            writer.writerow([name, heading, *ends])
            stream.flush()
    return moves


def _moves_so_far(file: Path) -> dict[tuple[str, int], tuple[str, str]]:
    """The moves of an earlier run; a last line that was not finished is cut off."""
    if not file.is_file():
        return {}
    text = file.read_text()
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        file.write_text(whole)
    rows = csv.reader(whole.splitlines())
    return {(name, int(heading)): (ahead, back) for name, heading, ahead, back in rows}


def _place_at(metadata: Mapping[str, Any], places: dict[str, Position], step: float) -> str:
    """The position where the agent is; empty if it is none of them."""
    at = metadata["agent"]["position"]
    for name, position in places.items():
        if max(abs(at[axis] - position[axis]) for axis in "xz") < 0.1 * step:
            return name
    return ""


def _teleport(simulator: Simulator, position: Position, heading: float) -> tuple[Any, str]:
    """Teleport the agent; the event, and the reason for a failure (empty if there is none)."""
    turned = {"x": 0.0, "y": float(heading), "z": 0.0}
    event = simulator.step("Teleport", position=position, rotation=turned, horizon=0.0, standing=True)
    if not event.metadata["lastActionSuccess"]:
        return event, " ".join(str(event.metadata["errorMessage"]).split())[:200] or "Teleport failed"
    agent = event.metadata["agent"]
    off = max(abs(agent["position"][axis] - position[axis]) for axis in "xz")
    turn = abs((agent["rotation"]["y"] - heading + 180) % 360 - 180)
    if off > 0.02 or turn > 1:
        return event, f"Teleport left the agent {off:.2f} m and {turn:.0f} degrees off"
    return event, ""


def _image(name: str, heading: int) -> str:
    return f"images/{name}_{heading:03d}.webp"


def _simulator_errors(where: str) -> AbstractContextManager[None]:
    return simulator_errors(f"{where}: AI2-THOR", "the same command continues from here")
