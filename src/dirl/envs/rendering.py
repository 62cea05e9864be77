"""The picture that the Gymnasium environments render."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from dirl.scenes import Scene
from dirl.scenes.geometry import heading_directions, step_length
from dirl.scenes.palette import BLUE, GOAL_COLOR, WALL_COLOR, star_points

HEIGHT = 300
"""Of a picture, pixels."""


class Painter:
    """Draws the view, the goal's view and the map side by side; the constant parts are drawn once.

    Args:
        scene: the room.
        view: returns the view of a state, uint8 ``[H, W, 3]``.
    """

    def __init__(self, scene: Scene, view: Callable[[int], NDArray[np.uint8]]) -> None:
        self.view = view
        self.directions = heading_directions(scene)
        side = step_length(scene)
        low, high = scene.positions.min(0) - side, scene.positions.max(0) + side
        self.scale = HEIGHT / (high[1] - low[1])
        self.cell = self.scale * side
        # Rows of a picture run down, z runs up.
        self.pixels = (scene.positions - [low[0], high[1]]) * [self.scale, -self.scale]
        self.width = max(1, round((high[0] - low[0]) * self.scale))
        self.panels: dict[int, Image.Image] = {}
        self.maps: dict[int, Image.Image] = {}

    def paint(self, goal: int, state: int) -> NDArray[np.uint8]:
        """The picture of an agent at ``state`` on its way to the state ``goal``, uint8 ``[300, W, 3]``."""
        if goal not in self.maps:
            self.maps[goal] = self._map(goal)
        room = self.maps[goal].copy()
        self._arrow(ImageDraw.Draw(room), state, BLUE)
        return np.concatenate([np.asarray(self._panel(state)), np.asarray(self._panel(goal)), np.asarray(room)], 1)

    def _panel(self, state: int) -> Image.Image:
        if state not in self.panels:
            view = Image.fromarray(self.view(state))
            self.panels[state] = view.resize((max(1, round(HEIGHT * view.width / view.height)), HEIGHT))
        return self.panels[state]

    def _map(self, goal: int) -> Image.Image:
        room = Image.new("RGB", (self.width, HEIGHT), WALL_COLOR)
        draw, half = ImageDraw.Draw(room), self.cell / 2
        for x, y in np.unique(self.pixels.round(3), axis=0):
            draw.rectangle((x - half, y - half, x + half, y + half), fill="white", outline="#e6e6e6")
        tip = self.pixels[goal] + 0.55 * self.cell * self.directions[goal] * [1, -1]
        draw.line([tuple(self.pixels[goal]), tuple(tip)], fill="black", width=max(1, round(0.06 * self.cell)))
        x, y = map(float, self.pixels[goal])
        draw.polygon(star_points(x, y, 0.42 * self.cell), fill=GOAL_COLOR, outline="black")
        return room

    def _arrow(self, draw: ImageDraw.ImageDraw, state: int, colour: str) -> None:
        """A disc at the state's place and a triangle that points to where it faces."""
        at, radius = self.pixels[state], 0.3 * self.cell
        ahead = self.directions[state] * [1, -1]
        aside = ahead[::-1] * [1, -1]
        draw.ellipse((*(at - radius), *(at + radius)), fill=colour)
        tip = [at + 1.6 * radius * ahead, at + 0.9 * radius * aside, at - 0.9 * radius * aside]
        draw.polygon([(float(x), float(y)) for x, y in tip], fill=colour, outline="black")
