"""Where the goal lies, by all that was seen in an episode: a posterior over the cells of a grid around the start."""

import math

import torch
from torch import Tensor

REACH = 24
"""Cells from the start to each edge of the grid; a cell is as wide as a move is long."""

UNLIKELY = -9.0
"""The least log probability of a cell: a network that was never wrong in training can be."""

GROWTH = 0.5
"""The mean of what n visits say counts n to this power: they share the error of the goal's look."""

CLEAR = 6.0
"""The most that the posterior adds to the log odds of a place, or takes from them."""

ROOM = 30
"""Cells where a goal may be, before anything was seen."""

AGENTS_AT_ONCE = 1024
"""Of many agents, so many are taken at a time."""


class GoalBelief:
    """Where the goals of B agents lie, in right turns and moves since the start of each one's episode.

    Every visit says, facing each view, how likely the goal lies so far ahead and to the right. Dead reckoning tells
    where the visit was, so what all visits say can be added up in the cells of one grid.
    """

    def __init__(self, agents: int, device: torch.device | str = "cpu") -> None:
        self.cells = torch.zeros((agents, 2 * REACH + 1, 2 * REACH + 1), device=device)
        """The sum of the log probabilities of all visits: ``[b, y, x]`` of the cell ``y - REACH`` moves ahead and
        ``x - REACH`` to the right of the start."""
        self.visits = torch.zeros(agents, device=device)
        self.length = torch.ones(agents, dtype=torch.int64, device=device)
        self.posterior = torch.full_like(self.cells, 1 / (2 * REACH + 1) ** 2)
        """The probability that the goal is in each cell, as ``cells``."""

    def see(
        self, displacement: Tensor, position: Tensor, heading: Tensor, turns: int, length: Tensor | None = None
    ) -> None:
        """Add what a visit says of the goal; forget what others said by another length of moves.

        Args:
            displacement: log probability that the goal lies so many moves ahead (rows) and to the right (columns) of
                the agent, facing each of its views, float32 ``[B, V, S, S]``; the agent is in the middle.
            position: of the visit, to the right of and ahead of the start, in moves, float32 ``[B, 2]``.
            heading: of the first view, in right turns since the start, int64 ``[B]``.
            turns: in a full circle.
            length: of a move, in cells, int64 ``[B]``; as before if left out.
        """
        if length is not None:
            self.cells[changed := self.length != length] = 0.0
            self.visits[changed] = 0.0
            self.length = length
        position = position * self.length[:, None]
        for some in torch.arange(len(position), device=position.device).split(AGENTS_AT_ONCE):
            self.cells[some] += _from_the_start(displacement[some], position[some], heading[some], turns)
        self.visits += 1
        self.posterior = (
            (self.cells * (self.visits ** (GROWTH - 1))[:, None, None]).flatten(1).softmax(1).view_as(self.cells)
        )

    def odds(self, position: Tensor) -> Tensor:
        """Return how much more likely the goal is at positions than before anything was seen, log ratios ``[B, P]``.

        Positions are as those of visits, float32 ``[B, P, 2]``.
        """
        return (ROOM * self.posterior.flatten(1).gather(1, self._cells(position))).log().clamp(-CLEAR, CLEAR)

    def moves(self, position: Tensor) -> Tensor:
        """Return how many moves positions are from the goal in the mean, along the axes; as `odds`."""
        cell = self._cells(position)
        axis = torch.arange(2 * REACH + 1, device=cell.device)
        apart = (axis[:, None] - axis).abs().float()
        along_x, along_y = (self.posterior.sum(across) @ apart for across in (1, 2))
        away = along_x.gather(1, cell % len(axis)) + along_y.gather(1, cell // len(axis))
        return away / self.length[:, None]

    def _cells(self, position: Tensor) -> Tensor:
        position = position * self.length[:, None, None]
        right, ahead = (position.round().long() + REACH).clamp(0, 2 * REACH).unbind(-1)
        return ahead * (2 * REACH + 1) + right

    def select(self, chosen: Tensor) -> None:
        """Keep some of the agents, by mask or index."""
        self.cells, self.posterior = self.cells[chosen], self.posterior[chosen]
        self.visits, self.length = self.visits[chosen], self.length[chosen]


def here_odds(located: Tensor) -> Tensor:
    """Return the log odds that the goal is where agents stand, float32 ``[B]``, of `GoalBelief.see`'s displacement."""
    middle = located.shape[-1] // 2
    here = located[..., middle, middle].clamp(min=UNLIKELY).mean(1)
    return here.exp().logit(eps=math.exp(UNLIKELY))


def _from_the_start(displacement: Tensor, position: Tensor, heading: Tensor, turns: int) -> Tensor:
    """Return what a visit says, see `GoalBelief.see`, of the cells around the start: the mean of its views."""
    _, views, side, _ = displacement.shape
    axis = torch.arange(-REACH, REACH + 1, device=position.device)
    ahead, right = torch.meshgrid(axis, axis, indexing="ij")
    ahead, right = ahead - position[:, 1, None, None], right - position[:, 0, None, None]
    told = torch.zeros_like(ahead)
    for view in range(views):
        angle = (2 * math.pi / turns * (heading + turns // views * view))[:, None, None]
        row = (right * angle.sin() + ahead * angle.cos()).round().long() + side // 2
        column = (right * angle.cos() - ahead * angle.sin()).round().long() + side // 2
        outside = (torch.minimum(row, column) < 0) | (torch.maximum(row, column) >= side)
        cell = torch.where(outside, 0, row * side + column).flatten(1)
        facing = displacement[:, view].flatten(1).gather(1, cell).view_as(told).clamp(min=UNLIKELY)
        told += torch.where(outside, UNLIKELY, facing) / views
    return told
