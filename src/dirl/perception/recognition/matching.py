"""Recognising that the goal has been reached (paper section 3.4)."""

from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from torch import Tensor

from dirl.perception.recognition.recogniser import NCC, Recogniser, in_blocks, ncc, normal_vectors
from dirl.perception.recognition.tables import VisitScores, described_visits, matched
from dirl.scenes.world import World

__all__ = ["FRONT_THRESHOLD", "TemplateStop", "ncc", "normal_vectors", "template_vectors"]

FRONT_THRESHOLD = 0.95
"""Above which one photo matches: other places are more like a goal in one view than in four, see docs/decisions.md."""

StopRule = Callable[[Tensor, Tensor], Tensor]
"""Of goals, by their place among a world's goals plus G times their look, and of what is seen ahead, by view id, int64
``[...]`` each: whether an agent stops there, bool ``[...]``."""

ScoreFunction = Callable[[Tensor, Tensor], Tensor]
"""The same, but the scores instead, float32 ``[...]``."""


def template_vectors(features: Tensor, surrounding: Tensor, match: str) -> Tensor:
    """The compared vector of each state, scaled so that the product of two is their coefficient, float32 ``[N, D']``.

    Features are float32 ``[N, D]``, the states ahead, right, back and left of each int64 ``[N, 4]``; of ``match`` see
    `TemplateStop`.
    """
    return normal_vectors(features if match == "front" else features[surrounding].flatten(1))


@dataclass(frozen=True)
class TemplateStop:
    """Stop where the observation matches the goal.

    Args:
        threshold: stop above this coefficient (the paper's is 0.9).
        match: what is compared: ``views``, all four of them, or ``front``, the one ahead.
        recogniser: compares it; the paper's is template matching by correlation.
    """

    threshold: float = 0.9
    match: str = "views"
    recogniser: Recogniser = field(default_factory=NCC, compare=False)

    def __post_init__(self) -> None:
        if self.match not in ("views", "front"):
            raise ValueError(f"match is 'views' or 'front', not '{self.match}'")

    @torch.no_grad()  # a learned recogniser has weights
    def scores(self, world: World) -> Tensor:
        """The score of every pair of a goal and a state of its scene, float32 ``[P]``, see `World.pair`.

        In a world that changes both are seen in their default look.
        """
        found = []
        for index, scene in enumerate(world.scenes):
            visits = described_visits(self.recogniser, world, index)[: len(scene)]
            goals = matched(visits[world.local_goals(index)], self.match)
            found.append(in_blocks(self.recogniser, visits, goals).T.flatten())
        return torch.cat(found)

    def __call__(self, world: World) -> Tensor:
        """Where an agent stops on its way to each goal, bool ``[P]``; not where it cannot be reached from."""
        return (self.scores(world) > self.threshold) & (world.distances >= 0)

    def arrived(self, world: World) -> StopRule:
        """The same in a world that changes, where it depends on the looks of the goal and of the visit."""
        compared = self.compared(world)
        return lambda wanted, picture: compared(wanted, picture) > self.threshold

    def compared(self, world: World) -> ScoreFunction:
        """The scores by which an agent would stop, for one that weighs them itself."""
        scores, states, goals = VisitScores(self.recogniser, world, self.match), len(world), len(world.goals)
        return lambda wanted, picture: scores(world.goals[wanted % goals] + wanted // goals * states, picture)
