"""MiniWorld: rooms and mazes of coloured walls, drawn with OpenGL, here without a display."""

from collections.abc import Callable
from contextlib import redirect_stdout
from io import StringIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dirl.scenes.io.files import check_choice
from dirl.scenes.live import Pose, simulator_errors
from dirl.scenes.scene import SceneError

LIBRARIES = "libegl1 libgl1-mesa-dri libglu1-mesa libfreetype6 libfontconfig1"
"""Debian's names of what OpenGL and pyglet need without a display."""

STRIDE = 0.05
"""Metres between the points of a move that are checked."""


class MiniWorld:
    """An environment of MiniWorld as a `dirl.scenes.live.Simulator`.

    Coordinates are metres, x as in MiniWorld and z against it, so that headings grow clockwise.

    Args:
        env: such as ``FourRooms``, which is ``MiniWorld-FourRooms-v0``.
        seed: of its walls and things.
        height, width: of a view, pixels.
        field_of_view: vertical, degrees.

    Raises:
        SceneError: MiniWorld is not installed or cannot draw, or there is no such environment.
    """

    def __init__(
        self, env: str, *, seed: int = 0, height: int = 120, width: int = 160, field_of_view: float = 60.0
    ) -> None:
        make, names = _registered()
        check_choice(env, [name.split("-")[1] for name in names], "MiniWorld", "environment")
        self.name = f"{env}_{seed}"
        # It tells about samples of pixels.
        remedy = f"without a display it needs, in Debian: apt install {LIBRARIES}"
        with simulator_errors(f"{self.name}: MiniWorld", remedy), redirect_stdout(StringIO()):
            wrapped = make(f"MiniWorld-{env}-v0", obs_height=height, obs_width=width, domain_rand=False)
            wrapped.reset(seed=seed)
        self._world = wrapped.unwrapped
        self._agent = self._world.agent
        self._agent.cam_fov_y = field_of_view
        self._heading = round(float(90 - np.degrees(self._agent.dir)) % 360 / 90) * 90.0 % 360

    @property
    def pose(self) -> Pose:
        """Where the agent is."""
        return Pose(float(self._agent.pos[0]), -float(self._agent.pos[2]), self._heading)

    def place(self, pose: Pose) -> None:
        """Put the agent somewhere."""
        self._agent.pos = np.array([pose.x, 0.0, -pose.z])
        self._face(pose.heading)
        self._heading = pose.heading

    def push(self, metres: float) -> bool:
        """Walk along the heading, backwards if negative; where something is in the way, not at all."""
        self._face(self._heading)
        start, way = self._agent.pos, metres * self._agent.dir_vec
        for share in np.linspace(0, 1, int(np.ceil(abs(metres) / STRIDE)) + 1)[1:]:
            if self._world.intersect(self._agent, start + share * way, self._agent.radius):
                return False
        self._agent.pos = start + way
        return True

    def look(self, heading: float) -> NDArray[np.uint8]:
        """Return the view towards a heading."""
        self._face(heading)
        with simulator_errors(f"{self.name}: MiniWorld"):
            return np.array(self._world.render_obs())

    def _face(self, heading: float) -> None:
        self._agent.dir = np.radians(90 - heading)


def _registered() -> tuple[Callable[..., Any], list[str]]:
    """Return Gymnasium's maker of environments and the names of MiniWorld's; set drawing to go without a display."""
    try:
        import pyglet

        pyglet.options["headless"] = True
        import gymnasium
        import miniworld.envs  # noqa: F401  registers them
    except Exception as error:  # pyglet opens a window at once, which fails in many ways
        raise SceneError(
            f"MiniWorld cannot be used ({type(error).__name__}: {error}): pip install 'dirl[miniworld]'; without a "
            f"display it needs EGL, in Debian: apt install {LIBRARIES}"
        ) from None
    return gymnasium.make, sorted(name for name in gymnasium.registry if name.startswith("MiniWorld-"))
