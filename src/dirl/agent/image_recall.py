"""The episodic memory of an agent that sees images: it recognises places by their views."""

from collections.abc import Callable

import torch
from torch import Tensor

from dirl.agent.recall import Memory
from dirl.envs.transforms import VIEWS
from dirl.models import EpisodicMemory, PlanningMemory
from dirl.recognition.matching import normal_vectors

Around = Callable[[], tuple[Tensor, Tensor]]
"""Of B agents the policy's logits facing each of the four views, ``[B, 4, 4]``, and whether the goal is seen there."""


class Counting:
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

    def adjust(self, features: Tensor, logits: Tensor, around: Around) -> Tensor:
        """Adjust logits ``[B, 4]`` by the actions that were taken where all views looked as they do now.

        Args:
            features: of the views around each agent, float32 ``[B, 4, D]``.
            logits: of the policy.
            around: not used.
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


class Planning:
    """The views and actions of B agents in their episodes, for `PlanningMemory`.

    Args:
        memory: plans.
    """

    def __init__(self, memory: PlanningMemory) -> None:
        self.memory = memory
        self.clear()

    def clear(self) -> None:
        """Begin new episodes."""
        self.looks: Tensor | None = None
        """Normalised features of all places so far, float32 ``[B, P, F]``, facing as at the first arrival."""
        self.walked = self.memory.begin(0)

    def adjust(self, features: Tensor, logits: Tensor, around: Around) -> Tensor:
        """The logits of the plan, ``[B, 4]``, for those of the policy; see `Counting.adjust`."""
        facing = torch.stack([normal_vectors(features.roll(turns, 1).flatten(1)) for turns in range(VIEWS)], 1)
        if self.looks is None:
            self.looks, self.walked = facing[:, :0], self.memory.begin(len(logits), logits.device)
        # An agent that turned right since its first arrival sees the same views rolled by minus one. Rolled back they
        # look alike: it is at the place, facing right.
        alike = (self.looks.unsqueeze(2) * facing.unsqueeze(1)).sum(-1) > self.memory.threshold
        same = alike.flatten(1) & self.walked.used
        self.looks = torch.cat([self.looks, facing[:, :1]], 1)
        self.walked = self.memory.arrive(self.walked, same, *around())
        return self.memory.plan(self.walked)

    def acted(self, action: Tensor) -> None:
        """Remember the actions that the agents take now, int64 ``[B]``."""
        self.walked.action = action


Recall = Counting | Planning


def recalling(memory: Memory) -> Recall:
    """A memory at the start of an episode."""
    return Planning(memory) if isinstance(memory, PlanningMemory) else Counting(memory)
