"""The episodic memory of an agent that sees images: it recognises places by their views."""

import torch
from torch import Tensor

from dirl.models import EpisodicMemory
from dirl.scenes.matching import normal_vectors


class Recall:
    """The views and actions of B agents in their episodes, for `EpisodicMemory`.

    Args:
        memory: lowers the logits of actions that were taken before.
    """

    def __init__(self, memory: EpisodicMemory) -> None:
        self.memory = memory
        self.clear()

    def clear(self) -> None:
        """Begin new episodes."""
        self.looks: Tensor | None = None
        """Normalised features of all steps so far, float32 ``[B, T, F]``; a dot product of two is their correlation."""
        self.trace = self.memory.begin(0)
        self.action: Tensor | None = None

    def adjust(self, features: Tensor, logits: Tensor) -> Tensor:
        """Adjust logits ``[B, 4]`` by the actions that were taken where all views looked as they do now.

        Args:
            features: of the views around each agent, float32 ``[B, 4, D]``.
            logits: of the policy.
        """
        agents, device = len(logits), logits.device
        now = normal_vectors(features.flatten(1)).unsqueeze(1)
        if self.looks is None:
            self.looks, self.trace = now, self.memory.begin(agents, device)
        else:
            self.looks = torch.cat([self.looks, now], 1)
            moved = (self.looks[:, -2:-1] * now).sum(-1).squeeze(1) <= self.memory.threshold
            place = torch.full((agents,), self.looks.shape[1] - 1, device=device)
            assert self.action is not None
            self.trace = self.memory.record(self.trace, place - 1, self.action, place, moved)
        alike = (self.looks * now).sum(-1) > self.memory.threshold
        return self.memory.adjust(logits, self.trace, alike.gather(1, self.trace.place))

    def acted(self, action: Tensor) -> None:
        """Remember the actions that the agents take now, int64 ``[B]``."""
        self.action = action
