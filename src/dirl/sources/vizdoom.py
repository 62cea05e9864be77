"""VizDoom: the maps of Doom and of Freedoom, which come with it, without monsters and without things to take."""

import os
import struct
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps

from dirl.scenes.io.files import open_regular
from dirl.scenes.io.processes import end_with_this_process
from dirl.scenes.live import Pose, simulator_errors
from dirl.scenes.scene import SceneError

UNITS = 32
"""Units of a map for a metre."""

PUSH = 50.0
"""The strongest push forward that Doom takes; each tic it adds 1/32 of that to the speed, in units."""

NEARER = 0.35
"""What is walked in a tic of what is left of a move; more could not be braked."""

TICS = 80
"""After so many a move has failed."""

ASIDE = 8
"""Units: a move that slides so far aside along a wall has failed."""

SETTLED = 12
"""Tics after which the eyes are at their height again."""

MOST_LUMPS = 100_000
"""Entries of a WAD file's directory that are read; Freedoom 2 has 3,000."""

SCENERY = {"Self", "Decoration", "Vegetation", "LightSource", "Gore", "Hazard", "Unknown"}
"""Categories of things that stay; others change the views once they are taken."""


class VizDoom:
    """A map of VizDoom as a `dirl.scenes.live.Simulator`; coordinates are those of the map, 32 units a metre.

    Args:
        name: of the map: ``map01`` to ``map32`` are Freedoom 2's, ``E1M1`` to ``E4M9`` those of Freedoom 1.
        wad: a file with maps of one's own, for Freedoom 2; the maps that come along if left out.
        height, width: of a view, pixels.

    Raises:
        SceneError: VizDoom is not installed or does not start, or there is no such map.
    """

    def __init__(self, name: str, *, wad: str | None = None, height: int = 120, width: int = 160) -> None:
        try:
            import vizdoom
        except ImportError as error:
            raise SceneError(f"VizDoom is not installed ({error}): pip install 'dirl[vizdoom]'") from None
        own = Path(vizdoom.__file__).parent / ("freedoom1.wad" if name.upper().startswith("E") else "freedoom2.wad")
        _check_map(Path(wad) if wad else own, name)
        self.name = f"{Path(wad or own).stem}_{name.lower()}"
        self.size = (width, height)
        self._moved = True
        self._game = game = vizdoom.DoomGame()
        game.set_doom_config_path(os.devnull)  # else it leaves a file of settings where one works
        game.set_doom_game_path(str(own))
        if wad:
            game.set_doom_scenario_path(wad)
        game.set_doom_map(name)
        game.set_window_visible(False)
        game.set_screen_resolution(vizdoom.ScreenResolution.RES_320X240)
        game.set_screen_format(vizdoom.ScreenFormat.RGB24)
        for shown in ("hud", "weapon", "crosshair", "messages", "particles", "corpses"):
            getattr(game, f"set_render_{shown}")(False)
        game.set_objects_info_enabled(True)
        game.set_available_buttons([vizdoom.Button.TURN_LEFT_RIGHT_DELTA, vizdoom.Button.MOVE_FORWARD_BACKWARD_DELTA])
        game.set_button_max_value(vizdoom.Button.TURN_LEFT_RIGHT_DELTA, 360)
        names = ("POSITION_X", "POSITION_Y", "ANGLE", "VELOCITY_X", "VELOCITY_Y")
        self._variables = [getattr(vizdoom.GameVariable, name) for name in names]
        game.set_available_game_variables(self._variables)
        game.set_mode(vizdoom.Mode.PLAYER)
        game.set_episode_timeout(0)
        game.add_game_args("+sv_nomonsters 1 +sv_cheats 1 +freeze 1")
        game.set_seed(1)
        with simulator_errors(f"{self.name}: VizDoom"):
            end_with_this_process(self, game)
            game.init()
            self._tics(0, 0, SETTLED)  # until then Doom takes no commands
            for thing in {item.name for item in game.get_state().objects if item.category not in SCENERY}:
                game.send_game_command(f"remove {thing}")  # what can be taken
            game.send_game_command("god")  # makes the agent invulnerable
            self._tics(0, 0, SETTLED)
        with suppress(OSError):  # an empty folder that Doom leaves
            Path("_vizdoom").rmdir()

        self._heading = self.pose_in_game()[2]

    @property
    def pose(self) -> Pose:
        """Where the agent is."""
        x, y, _ = self.pose_in_game()
        return Pose(x, y, self._heading)

    def pose_in_game(self) -> Pose:
        """Return where Doom's player is and looks."""
        x, y, angle = (self._game.get_game_variable(variable) for variable in self._variables[:3])
        return Pose(x / UNITS, y / UNITS, (90 - angle) % 360)

    def place(self, pose: Pose) -> None:
        """Put the agent somewhere; `SceneError` where it cannot stand."""
        with simulator_errors(f"{self.name}: VizDoom"):
            self._warp(pose)
        at = self.pose_in_game()
        if np.hypot(at.x - pose.x, at.z - pose.z) > 0.05:
            raise SceneError(f"{self.name}: the agent cannot be put at {pose.x:.2f}, {pose.z:.2f} m")

    def push(self, metres: float) -> bool:
        """Walk along the heading, backwards if negative, until the agent arrives or is stopped."""
        start, way, arrived = self.pose, np.sign(metres), False
        radians = np.radians(start.heading)
        along = way * np.array([np.sin(radians), np.cos(radians)])
        end = np.array(start[:2]) + abs(metres) * along
        still = 0
        with simulator_errors(f"{self.name}: VizDoom"):
            self._turn(start.heading)
            for _ in range(TICS):
                left = (end - self.pose[:2]) * UNITS
                speed = along @ self._speed()
                arrived = bool(np.abs(left).max() < 1)
                if arrived or still > 3 or np.abs(left - (along @ left) * along).max() > ASIDE:
                    break
                thrust = 32 * (NEARER * (along @ left) - speed)
                self._tics(0, way * np.clip(thrust, -PUSH, PUSH), 1)
                still = still + 1 if abs(along @ self._speed()) < 0.05 else 0
            stop = Pose(float(end[0]), float(end[1]), start.heading) if arrived else start
            self._warp(stop)
            for _ in range(TICS):  # until it has lost its speed; on a floor that carries, it never does
                if np.abs(self._speed()).max() < 0.05:
                    break
                self._tics(0, 0, 4)
                self._warp(stop)
        return arrived

    def look(self, heading: float) -> NDArray[np.uint8]:
        """Return the view towards a heading."""
        with simulator_errors(f"{self.name}: VizDoom"):
            self._turn(heading)
            self._tics(0, 0, SETTLED if self._moved else 1)
            self._moved = False
            image = Image.fromarray(self._game.get_state().screen_buffer)
        return np.asarray(ImageOps.fit(image, self.size, Image.Resampling.LANCZOS))

    def _speed(self) -> NDArray[np.float64]:
        return np.array([self._game.get_game_variable(variable) for variable in self._variables[3:]])

    def _tics(self, turn: float, push: float, count: int) -> None:
        self._game.make_action([turn, push], count)

    def _warp(self, pose: Pose) -> None:
        self._game.send_game_command(f"warp {pose.x * UNITS:.3f} {pose.z * UNITS:.3f}")
        self._tics(0, 0, 1)
        self._heading, self._moved = pose.heading, True

    def _turn(self, heading: float) -> None:
        for _ in range(3):  # the second and third time for rounding
            off = (heading - self.pose_in_game().heading + 180) % 360 - 180
            if abs(off) < 0.05:
                return
            self._tics(off, 0, 1)


def _check_map(wad: Path, name: str) -> None:
    """Raise `SceneError` unless a WAD file holds a map: Doom starts without one, somewhere else."""
    try:
        with open_regular(wad) as file:
            kind, count, at = struct.unpack("<4sii", file.read(12))
            file.seek(at)
            directory = file.read(16 * min(count, MOST_LUMPS))
            lumps = [
                directory[i : i + 8].rstrip(b"\0").decode("ascii", "replace") for i in range(8, len(directory), 16)
            ]
    except (OSError, ValueError, struct.error) as error:
        raise SceneError(f"{wad}: not a readable WAD file ({error})") from None
    maps = [lump for lump, after in pairwise(lumps) if after in ("THINGS", "TEXTMAP")]
    if kind not in (b"IWAD", b"PWAD") or name.upper() not in maps:
        raise SceneError(f"map={name}: {wad.name} holds no such map; it holds {', '.join(maps) or 'none'}")
