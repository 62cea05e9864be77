"""Being led by a `FrameMap` to where a photo was taken, by a camera ahead and turns of any angle."""

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from dirl.agent.mapping.frames import ZOOMS, FrameMap

AHEAD, LEFT, RIGHT, BACK = 1, 2, 3, 4

STRAIGHT = 8.0
"""Degrees: what is less aside lies ahead."""

KNOWN = 0.28
"""Least correlation of a frame with what is seen there."""

NEARLY = 0.75
"""Of the best correlation: the farthest frame that fits so well leads."""

BEHIND, BEFORE = 2, 6
"""Frames of the path around the present one that are compared."""

CIRCLE = 14
"""Turns in which one has looked around."""

PATIENCE = 25
"""Actions without progress, after which one walks at random and looks around again."""

FADE, MOST = 0.8, 3.0
"""How much of earlier evidence is left after an action, and the most of one view, standard deviations."""

SAME_PLACE = 20
"""Frames around a goal in vain that are not tried again."""


class Follower:
    """Walks to a photo by a map: call `act` with what is seen, until told that the goal is reached.

    Args:
        graph: the map.
        fits: how well each of its frames fits the photo, ``[N]``, see `fits`.
        photo: RGB, uint8 ``[H, W, 3]``.
        seed: of what it does when it is stuck.
    """

    def __init__(self, graph: FrameMap, fits: NDArray[np.float64], photo: NDArray[np.uint8], seed: int = 0) -> None:
        self.graph, self.photo, self._random = graph, graph.describe(photo[None]), np.random.default_rng(seed)
        self._fits = fits.copy()
        self._plan: list[int] = []
        self._choose()
        self._look()

    def act(self, frame: NDArray[np.uint8]) -> int:
        """What to do next: `AHEAD`, `LEFT`, `RIGHT` or `BACK`.

        Args:
            frame: what is seen, RGB, uint8 ``[H, W, 3]``.
        """
        seen = torch.cat([self.graph.describe(frame[None], zoom) for zoom in ZOOMS])
        self._believe(self.graph.likeness(seen[:1]))
        if self._plan:
            return self._plan.pop()
        if self._looking < CIRCLE:
            self._looking += 1
            return RIGHT
        path = self._path()
        views = torch.cat([self.graph.views[path], self.photo]) if self._at_end(path) else self.graph.views[path]
        found = self.graph.compared(seen, views)
        best = float(found.score.max())
        if best < KNOWN:
            return self._lost()
        self._unknown = 0
        leading = int(torch.nonzero(found.score >= NEARLY * best).max())
        self._since = 0 if self.far[self.node] < self._least else self._since + 1
        self._least = min(self._least, self.far[self.node])
        if self._since > PATIENCE:
            if self._at_end(path):
                self._in_vain(self.node)
            return self._wander()
        degrees = float(found.degrees[leading])
        if abs(degrees) <= STRAIGHT:
            return AHEAD
        return RIGHT if degrees > 0 else LEFT

    def _believe(self, likeness: Tensor) -> None:
        """Where one is: evidence fades, and one goes on along the recording; looking around, the best view counts."""
        if self._looking < CIRCLE:
            self._belief = torch.maximum(self._belief, likeness)
        else:
            before = F.pad(self._belief[None], (2, 1), value=-9.0)
            self._belief = FADE * F.max_pool1d(before, 4, 1)[0] + likeness.clamp(max=MOST)
        self.node = int(torch.where(self._reachable, self._belief, -torch.inf).argmax())

    def _choose(self) -> None:
        """Where the photo may have been taken, and the ways there."""
        best = self._fits.max()
        self.goals = np.flatnonzero(self._fits >= best - 0.2 * abs(best))
        self.far, self.following = self.graph.distances_to(self.goals)
        self._reachable = torch.from_numpy(np.isfinite(self.far))

    def _look(self) -> None:
        self._looking, self._belief = 0, torch.full((len(self.far),), -9.0)
        self._least, self._since, self._unknown = np.inf, 0, 0

    def _path(self) -> NDArray[np.int64]:
        """Frames around the present one on the way to the goal."""
        path = [max(0, self.node - back) for back in range(BEHIND, 0, -1)] + [self.node]
        while len(path) <= BEHIND + BEFORE and self.far[path[-1]] > 0:
            path.append(int(self.following[path[-1]]))
        return np.array(path)

    def _at_end(self, path: NDArray[np.int64]) -> bool:
        return bool(self.far[path[-1]] == 0)

    def _lost(self) -> int:
        """Turn until something is known."""
        self._unknown += 1
        return self._wander() if self._unknown > CIRCLE else RIGHT

    def _wander(self) -> int:
        """Some steps at random, then look around."""
        self._look()
        side = int(self._random.choice([LEFT, RIGHT]))
        self._plan = [AHEAD] * int(self._random.integers(2, 8)) + [side] * int(self._random.integers(1, 6))
        return BACK

    def _in_vain(self, node: int) -> None:
        """The photo was not taken there."""
        self._fits[max(0, node - SAME_PLACE) : node + SAME_PLACE] = -1
        self._choose()


def fits(graph: FrameMap, photo: NDArray[np.uint8]) -> NDArray[np.float64]:
    """How well each frame of a map fits a photo, ``[N]``."""
    return graph.bearing(photo, np.arange(len(graph.frames))).score.double().numpy()
