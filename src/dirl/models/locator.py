"""A network that tells where the goal lies, by what an agent sees and by the goal's views."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dirl.envs.transforms import VIEWS
from dirl.perception.backbones.patches import FINE, FinePatches

PAIRS_AT_ONCE = 256
"""Visits whose fine patches are compared at a time: a hundred megabytes."""

COLUMNS_TOLD, VIEW_TOLD = 8, 128
"""Numbers that are told of two columns, and of each view around the agent."""

SCALE = 4.0
"""Factor of the cosines, so that the layers on them learn as fast as the others."""


class GoalLocator(nn.Module):
    """Tell where the goal lies: the log probability of each cell around the agent, which stands in the middle.

    A cell is as wide as a move was long in training, half a metre for the agent `general`. Rows lead ahead, columns to
    the right; what lies farther than ``reach`` cells counts to those at the edge. Where views have fine patches these
    are compared too, and tell most.

    Args:
        encoder: features of observation and goal, float32 ``[B, 4, D]`` each, to ``[B, width]``.
        width: see ``encoder``.
        reach: cells ahead, behind and to either side.
    """

    def __init__(self, encoder: nn.Module, width: int, reach: int) -> None:
        super().__init__()
        self.side = 2 * reach + 1
        self.encoder = encoder
        self.fine = FinePairs()
        self.fusion = nn.Linear(VIEWS * VIEW_TOLD, width, bias=False)
        self.layers = nn.Sequential(
            nn.Linear(width, width),
            nn.ReLU(),
            nn.Linear(width, width),
            nn.ReLU(),
            nn.Linear(width, self.side**2),
        )

    def forward(
        self,
        observation: Tensor,
        goal_observation: Tensor,
        patches: Tensor | None = None,
        goal_patches: Tensor | None = None,
    ) -> Tensor:
        """Return log probabilities facing each view, float32 ``[B, 4, S, S]``.

        Args:
            observation: features of the views around the agents, clockwise, float32 ``[B, 4, D]``.
            goal_observation: likewise, of the goals; of a photo three views are zero.
            patches: fine patches of the views around the agents, float ``[B, 4, 48, 96]``; None if there are none.
            goal_patches: of the goals, ``[B, 4, 48, 96]``, or of photos ``[B, 1, 48, 96]``.
        """
        compared = None
        if patches is not None and goal_patches is not None:
            pairs = zip(patches.split(PAIRS_AT_ONCE), goal_patches.split(PAIRS_AT_ONCE), strict=True)
            compared = torch.cat([self.fine(seen, goal) for seen, goal in pairs])
        facing = []
        for turns in range(VIEWS):
            fused = self.encoder(observation.roll(-turns, 1), goal_observation)
            if compared is not None:
                fused = fused + self.fusion(compared.roll(-turns, 1).flatten(1))
            facing.append(self.layers(fused))
        located = torch.stack(facing, 1)
        return located.float().log_softmax(-1).unflatten(-1, (self.side, self.side))


class FinePairs(FinePatches):
    """Compare the fine patches of each view around the agent with those of each view of the goal.

    A step towards what a view shows moves its patches away from the middle. So each column of one view is compared with
    each column of the other, all rows with all, by layers that are the same for every two columns. Every view of the
    goal is a photo that was taken at its place, and what several of them tell is added up.
    """

    def __init__(self) -> None:
        super().__init__(dropout=0.1)
        rows, columns = FINE
        self.columns = nn.Sequential(nn.Linear(2 * rows**2, 48), nn.ReLU(), nn.Linear(48, COLUMNS_TOLD), nn.ReLU())
        self.view = nn.Sequential(nn.Linear(columns**2 * COLUMNS_TOLD, VIEW_TOLD), nn.ReLU())

    def forward(self, patches: Tensor, goal_patches: Tensor) -> Tensor:
        """Return what is told of each view, float32 ``[B, 4, width]``, of ``[B, 4, 48, 96]`` and ``[B, V, 48, 96]``."""
        pairs = zip(self.describe(patches), self.describe(goal_patches), strict=True)
        # Of every view of the goal, view around the agent, column of the one and of the other: all rows with all.
        cosines = [torch.einsum("bvrcw,bgqdw->bgvcdrq", seen, goal).flatten(5) for seen, goal in pairs]
        told = self.columns(SCALE * torch.cat(cosines, -1)).flatten(3)
        return self.view(told).sum(1)

    def describe(self, patches: Tensor) -> tuple[Tensor, Tensor]:
        """Return patches projected and as they are, each of length one, ``[..., 48, 96]`` to ``[..., 6, 8, W]``."""
        standard = self.dropout(self.standardised(patches))
        parts = self.patch(standard), standard[..., : self.kept]
        projected, kept = (F.normalize(part, dim=-1).unflatten(-2, FINE) for part in parts)
        return projected, kept
