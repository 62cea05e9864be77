"""A Gymnasium environment that has only ``reset`` and ``step``, as a simulator: it is walked to every place."""

import pydoc
from collections import deque
from typing import Any

import numpy as np

from dirl.scenes.live import Image, Pose, SimulatorError
from dirl.scenes.scene import SceneError
from dirl.scenes.views import check_image

Cell = tuple[int, int]


class GymSimulator:
    """A `dirl.scenes.live.Simulator` of an environment with RGB observations and three discrete actions.

    Where the agent is, is counted from the start of an episode: a step ahead is blocked if the image stays as it was.
    It walks to every place, from the start of an episode if need be, so the environment must begin every episode alike
    and may not end one.

    Args:
        env: its class, ``package.module.Class``, made without arguments.
        ahead: the action that walks one step ahead.
        left: the action that turns left.
        right: the action that turns right.
        step: metres of a step.
        turn: degrees of a turn.
        image: the key of the image in observations that are dictionaries.
        seed: of every episode.
    """

    def __init__(
        self,
        env: str,
        *,
        ahead: int,
        left: int,
        right: int,
        step: float = 1.0,
        turn: int = 90,
        image: str | None = None,
        seed: int = 0,
    ) -> None:
        self.name = env.rpartition(".")[2]
        kind = pydoc.locate(env)
        if not callable(kind):
            raise SceneError(f"env={env}: there is no such class; is its folder on PYTHONPATH?")
        self.env: Any = kind()
        self.ahead, self.left, self.right = ahead, left, right
        self.step, self.turn, self.image, self.seed = step, turn, image, seed
        self.ways: dict[Cell, dict[int, Cell]] = {(0, 0): {}}  # by heading, of every place that was passed
        self.tried: set[tuple[Cell, int]] = set()
        self._restart()

    @property
    def pose(self) -> Pose:
        """Where the agent is, metres from its start."""
        return Pose(self.step * self.cell[0], self.step * self.cell[1], float(self.heading))

    def push(self, metres: float) -> bool:
        """Walk a step along the heading, or against it; of other lengths none is possible."""
        if abs(abs(metres) - self.step) > 0.01 * self.step or self.heading % 90:
            return False
        heading = self.heading
        self._face(heading if metres > 0 else heading + 180)
        moved = self._ahead()
        self._face(heading)
        return moved

    def look(self, heading: float) -> Image:
        """Return the view towards a heading."""
        before = self.heading
        self._face(heading)
        seen = self.seen
        self._face(before)
        return seen

    def place(self, pose: Pose) -> None:
        """Walk to a place; one that was not passed yet is looked for."""
        x, z = pose.x / self.step, pose.z / self.step
        goal = (round(x), round(z))
        if max(abs(x - goal[0]), abs(z - goal[1])) < 0.01:
            while goal not in self.ways and self._explore():
                pass
        if goal not in self.ways or max(abs(x - goal[0]), abs(z - goal[1])) > 0.01:
            raise SceneError(f"{self.name}: has only reset and step, so it cannot be put at {pose.x:g}, {pose.z:g} m")
        self._walk(goal)
        self._face(pose.heading)

    def _explore(self) -> bool:
        """Try a step that was not tried before, from a place that was passed; False if there is none."""
        untried = [(cell, h) for cell in self.ways for h in (0, 90, 180, 270) if (cell, h) not in self.tried]
        if untried:
            cell, heading = untried[0]
            self._walk(cell)
            self._face(heading)
            self._ahead()
        return bool(untried)

    def _walk(self, goal: Cell) -> None:
        """Walk to a place that was passed before, from the start of an episode if there is no known path from here."""
        path = self._path(goal)
        if path is None:
            self._restart()
            path = self._path(goal) or []
        for heading in path:
            self._face(heading)
            if not self._ahead():
                raise SimulatorError(f"{self.name}: a step is blocked that was possible before", "its episodes differ")

    def _path(self, goal: Cell) -> list[int] | None:
        """Return the headings of the shortest known path to a place; None if there is none from here."""
        paths, todo = {self.cell: list[int]()}, deque([self.cell])
        while todo:
            cell = todo.popleft()
            for heading, end in self.ways[cell].items():
                if end not in paths:
                    paths[end] = [*paths[cell], heading]
                    todo.append(end)
        return paths.get(goal)

    def _restart(self) -> None:
        self.cell, self.heading = (0, 0), 0
        self.seen = self._image(self.env.reset(seed=self.seed)[0])

    def _act(self, action: int) -> Image:
        observation, _, terminated, truncated, _ = self.env.step(action)
        if terminated or truncated:
            raise SimulatorError(f"{self.name}: it ended an episode", "make it without goals and limits of time")
        return self._image(observation)

    def _ahead(self) -> bool:
        self.tried.add((self.cell, self.heading))
        before, self.seen = self.seen, self._act(self.ahead)
        if np.array_equal(before, self.seen):
            return False
        radians = np.radians(self.heading)
        end = (self.cell[0] + round(np.sin(radians)), self.cell[1] + round(np.cos(radians)))
        self.ways[self.cell][self.heading] = end
        self.ways.setdefault(end, {})
        self.cell = end
        return True

    def _face(self, heading: float) -> None:
        """Turn to a heading, the shorter way."""
        turns = (heading - self.heading) / self.turn % (360 / self.turn)
        if abs(turns - round(turns)) > 0.01:
            raise SceneError(f"{self.name}: turns by {self.turn} degrees, so it cannot face {heading:g}")
        right = turns <= 180 / self.turn
        for _ in range(round(turns if right else 360 / self.turn - turns)):
            self.seen = self._act(self.right if right else self.left)
        self.heading = round(heading) % 360

    def _image(self, observation: Any) -> Image:
        image = observation[self.image] if self.image is not None else observation
        return check_image(np.asarray(image), f"{self.name}: its observation")
