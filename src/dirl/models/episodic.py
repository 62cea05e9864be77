"""An episodic memory without parameters: an agent that returns to a place tries another action there."""

from dataclasses import dataclass
from typing import Annotated

import torch
from torch import Tensor, nn

from dirl.config.bounds import Bounds

OPPOSITE = (3, 2, 1, 0)
"""Of ahead, right, left and back the action that undoes it."""


@dataclass
class Trace:
    """The actions of B agents in their present episodes, two entries a step; made by `EpisodicMemory.begin`."""

    place: Tensor
    """Where, int64 ``[B, H]``; what the numbers mean is the caller's, who says which places look the same."""
    action: Tensor
    """What, int64 ``[B, H]``."""
    weight: Tensor
    """How much it counts, float32 ``[B, H]``."""

    def select(self, chosen: Tensor) -> "Trace":
        """Return some of the agents, by mask or index."""
        return Trace(self.place[chosen], self.action[chosen], self.weight[chosen])


class EpisodicMemory(nn.Module):
    """Lowers the logit of each action by the number of times that the agent has taken it here in this episode.

    It breaks the loops of a greedy policy without memory. A step counts in both directions: an agent that went
    ahead from A to B took ``ahead`` at A, and ``back`` at B becomes less likely too. A move after which all views look
    as before was blocked, and is not tried again for long. Places are recognised by template matching (paper section
    3.4), as goals are, never by the number of a state.

    It is used in evaluation, in the viewer and in a `dirl.Navigator`, but not in training.

    Args:
        penalty: by which a logit falls for each time.
        opposite: what the opposite action counts; 0 for one direction only.
        blocked: what a blocked move counts.
        threshold: two observations above this correlation are of the same place and heading.
    """

    def __init__(
        self,
        penalty: Annotated[float, Bounds(0, 1000)] = 4.0,
        opposite: Annotated[float, Bounds(0, 1000)] = 1.0,
        blocked: Annotated[float, Bounds(0, 1000)] = 5.0,
        threshold: Annotated[float, Bounds(-1, 1)] = 0.9,
    ) -> None:
        super().__init__()
        self.penalty, self.opposite, self.blocked, self.threshold = penalty, opposite, blocked, threshold

    def begin(self, agents: int, device: torch.device | str = "cpu") -> Trace:
        """Return the empty trace of agents at the start of their episodes."""
        empty = torch.empty((agents, 0), dtype=torch.int64, device=device)
        return Trace(empty, empty, torch.empty((agents, 0), device=device))

    def adjust(self, logits: Tensor, trace: Trace, same: Tensor) -> Tensor:
        """Return the policy's logits, float32 ``[B, 4]``, lowered for actions that were taken here before.

        ``same`` is whether each place of the trace looks like where the agent is, bool ``[B, H]``.
        """
        return logits.scatter_add(1, trace.action, -self.penalty * (trace.weight * same).to(logits.dtype))

    def record(self, trace: Trace, place: Tensor, action: Tensor, after: Tensor, moved: Tensor) -> Trace:
        """The trace, extended by an action of each agent that led from one place to the next, int64 ``[B]`` each.

        ``moved`` is whether they look different, bool ``[B]``.
        """
        opposite = torch.tensor(OPPOSITE, device=action.device)[action]
        forth = torch.where(moved, 1.0, self.blocked)
        return Trace(
            torch.cat([trace.place, place[:, None], after[:, None]], 1),
            torch.cat([trace.action, action[:, None], opposite[:, None]], 1),
            torch.cat([trace.weight, forth[:, None], self.opposite * moved[:, None]], 1),
        )
