"""The lengths of the latest training episodes, and the frame from which the policy is stable."""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

WINDOW = 100
"""Training episodes of a goal that its current ATL is the mean of."""

STABLE_ATL = 20.0
"""A policy is called stable while the current ATL of every goal is at or under this."""

NEAR = 1.5
"""It is called near the shortest path while the current ATL of every goal is at or under so many times the shortest."""


class EpisodeMeter:
    """Lengths of the latest training episodes of each goal, and the frame from which the policy is stable.

    Args:
        shortest: the fewest steps to each goal, in the mean over its starts.
    """

    def __init__(self, shortest: Sequence[float]) -> None:
        self.shortest = shortest
        self.steps: list[deque[int]] = [deque(maxlen=WINDOW) for _ in shortest]
        self.totals = [0] * len(shortest)
        """Of ``steps``, so that an update does not add up the episodes of hundreds of goals again."""
        self.episodes = 0
        self.stable_at: int | None = None
        self.near_at: int | None = None

    def add(self, goal_index: Sequence[int], steps: Sequence[int], frames: int) -> None:
        """Count finished episodes in the order they ended; the last ended by ``frames``.

        The policy is stable from the first frame after which the mean steps of the last `WINDOW` episodes stay at or
        under `STABLE_ATL` for every goal, and near the shortest path from that after which they stay at or under
        `NEAR` times the fewest steps.
        """
        for goal, length in zip(goal_index, steps, strict=True):
            last = self.steps[goal]
            self.totals[goal] += length - (last[0] if len(last) == WINDOW else 0)
            last.append(length)
        self.episodes += len(steps)
        self.stable_at = self._since(self.stable_at, frames, [STABLE_ATL] * len(self.steps))
        self.near_at = self._since(self.near_at, frames, [NEAR * fewest for fewest in self.shortest])

    def _since(self, before: int | None, frames: int, limits: Sequence[float]) -> int | None:
        """Since when every goal is within its limit, given what it was before these frames."""
        within = (
            len(last) == WINDOW and total <= limit * WINDOW
            for last, total, limit in zip(self.steps, self.totals, limits, strict=True)
        )
        if not all(within):
            return None
        return frames if before is None else before

    @property
    def atl(self) -> float:
        """The current ATL of the goals that have any episode yet, averaged; NaN before there is one."""
        means = self._means()
        return sum(means) / len(means) if means else math.nan

    @property
    def worst_atl(self) -> float:
        """The current ATL of the goal with the highest one; NaN before there are any episodes."""
        return max(self._means(), default=math.nan)

    def success_rate(self, limit: int) -> float:
        """The fraction of these episodes that ended before the step limit, averaged over goals as the ATL is."""
        rates = [sum(steps < limit for steps in last) / len(last) for last in self.steps if last]
        return sum(rates) / len(rates) if rates else math.nan

    def _means(self) -> list[float]:
        return [total / len(last) for last, total in zip(self.steps, self.totals, strict=True) if last]

    def state_dict(self) -> dict[str, Any]:
        """What `load_state_dict` takes; the totals only tell whether the steps were changed."""
        return {
            "steps": [list(last) for last in self.steps],
            "totals": list(self.totals),
            "episodes": self.episodes,
            "stable_at": self.stable_at,
            "near_at": self.near_at,
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore a saved state."""
        self.steps = [deque(last, maxlen=WINDOW) for last in state["steps"]]
        self.totals = list(state["totals"])
        self.episodes, self.stable_at, self.near_at = state["episodes"], state["stable_at"], state["near_at"]
