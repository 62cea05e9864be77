"""Pictures of an agent in its room: the map that animations show too, and what the Gymnasium environments render."""

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from dirl.scenes import Scene
from dirl.scenes.palette import BLUE, COLORS, GOAL_COLOR, WALL_COLOR

HEIGHT = 300
"""Height of a rendered picture, pixels."""


class RoomMap:
    """The map of a room in pixels, drawn once without a path and copied for each picture.

    Args:
        scene: the room.
        goal: a state of it.
        largest: width and height of the picture, of which it reaches one.
        smooth: the map is drawn so many times larger and scaled down, because PIL draws jagged lines.
    """

    def __init__(self, scene: Scene, goal: int, largest: tuple[float, float], smooth: int = 1) -> None:
        side, self.smooth = scene.step_length, smooth
        low = scene.positions.min(0) - 0.75 * side
        spans = scene.positions.max(0) + 0.75 * side - low
        scale = (smooth * np.array(largest) / spans).min()
        self.side = side * scale
        width, height = (smooth * math.ceil(span * scale / smooth) for span in spans)
        x, z = (scene.positions - low).T * scale
        self.at = np.stack([x, height - z], 1)  # rows of an image count downwards
        self.ahead = scene.directions * (1, -1)
        self.room = Image.new("RGB", (width, height), WALL_COLOR)
        draw = ImageDraw.Draw(self.room)
        for x, y in np.unique(self.at.round(2), axis=0):
            half = self.side / 2
            draw.rectangle((x - half, y - half, x + half, y + half), fill="white", outline="#E5E5E5", width=smooth)
        tip = self.at[goal] + 0.62 * self.side * self.ahead[goal]
        draw.line([tuple(self.at[goal]), tuple(tip)], fill="black", width=2 * smooth)
        # The goal's star, one of its ten corners up.
        turns = math.pi / 5 * np.arange(10)
        reach = 0.44 * self.side * np.tile([1, 0.42], 5)
        star = self.at[goal] + np.stack([reach * np.sin(turns), -reach * np.cos(turns)], 1)
        draw.polygon([tuple(corner) for corner in star], fill=GOAL_COLOR, outline="black", width=smooth)

    def draw(self, path: Sequence[int], color: str) -> Image.Image:
        """Return the map with a path up to its last state, where the agent stands."""
        picture = self.room.copy()
        draw = ImageDraw.Draw(picture)
        width = max(self.smooth, int(0.16 * self.side))
        points = [tuple(self.at[state]) for state in path]
        if len(points) > 1:
            draw.line(points, fill=COLORS[4], width=width, joint="curve")
        x, y = points[0]
        draw.ellipse((x - width, y - width, x + width, y + width), fill=COLORS[4])
        # A dart that points along the heading.
        ahead = self.ahead[path[-1]]
        beside = np.array([-ahead[1], ahead[0]])
        corners = [ahead, -0.8 * ahead + 0.75 * beside, -0.4 * ahead, -0.8 * ahead - 0.75 * beside]
        dart = [tuple(self.at[path[-1]] + 0.34 * self.side * corner) for corner in corners]
        draw.polygon(dart, fill=color, outline="black", width=self.smooth)
        return picture.reduce(self.smooth)


class Painter:
    """Draws the view, the goal's view and the map side by side; the constant parts are drawn once.

    The view of a state is uint8 ``[H, W, 3]``.
    """

    def __init__(self, scene: Scene, view: Callable[[int], NDArray[np.uint8]]) -> None:
        self.scene, self.view = scene, view
        self.panels: dict[int, Image.Image] = {}
        self.maps: dict[int, RoomMap] = {}

    def paint(self, goal: int, state: int) -> NDArray[np.uint8]:
        """Return the picture of an agent at ``state`` on its way to the state ``goal``, uint8 ``[300, W, 3]``."""
        if goal not in self.maps:
            self.maps[goal] = RoomMap(self.scene, goal, (math.inf, HEIGHT))
        parts = self._panel(state), self._panel(goal), self.maps[goal].draw([state], BLUE)
        # Rounding can give a map one row of wall too many.
        return np.concatenate([np.asarray(part)[:HEIGHT] for part in parts], 1)

    def _panel(self, state: int) -> Image.Image:
        if state not in self.panels:
            view = Image.fromarray(self.view(state))
            self.panels[state] = view.resize((max(1, round(HEIGHT * view.width / view.height)), HEIGHT))
        return self.panels[state]
