"""Where one is in a recorded walk: a Bayes filter over its frames."""

import numpy as np
from numpy.typing import NDArray

MOVES = (0.08, 0.15, 0.25, 0.2, 0.15, 0.1, 0.07)
"""How likely one is 2 frames before, ..., 4 frames after the last one."""

ELSEWHERE, SHORTCUT = 0.03, 0.3
"""How likely one is anywhere, and at the other end of a link."""

AROUND = 3
"""Frames before and after that count as one place."""


class Belief:
    """Probabilities of the frames of a map, ``[N]``.

    Args:
        count: frames, N.
        links: pairs of frames of one place, int ``[L, 2]``.
    """

    def __init__(self, count: int, links: NDArray[np.int64]) -> None:
        self.of = np.full(count, 1 / count)
        self._ends = np.concatenate([links, links[:, ::-1]])

    def move(self) -> None:
        """Spread the probabilities as one walks on, or along a link, or is carried anywhere."""
        count = len(self.of)
        belief = np.convolve(self.of, MOVES)[2 : 2 + count]
        np.maximum.at(belief, self._ends[:, 1], SHORTCUT * self.of[self._ends[:, 0]])
        self.of = (1 - ELSEWHERE) * belief / belief.sum() + ELSEWHERE / count

    def weigh(self, likelihood: NDArray[np.float64]) -> None:
        """Weigh the frames by how likely what is seen is at each, ``[N]``."""
        belief = self.of * likelihood
        self.of = belief / belief.sum()

    def forget(self, share: float) -> None:
        """Mix with not knowing anything."""
        self.of = (1 - share) * self.of + share / len(self.of)

    def frame(self) -> tuple[int, float]:
        """The present frame, and how likely one is around it."""
        around = int(np.convolve(self.of, np.ones(2 * AROUND + 1), "same").argmax())
        first = max(0, around - AROUND)
        frame = first + int(self.of[first : around + AROUND + 1].argmax())
        return frame, float(self.of[max(0, frame - 8) : frame + 9].sum())
