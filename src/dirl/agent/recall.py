"""The episodic memory of agents on their way: what they see now, compared with all they have seen in the episode.

One code for agents in worlds and agents that see images. They differ in their `Sight` alone: a world's agents look
scores up, a camera's compute them.
"""

from collections.abc import Callable
from typing import Protocol

import torch
from torch import Tensor

from dirl.envs.transforms import VIEWS
from dirl.models import EpisodicMemory, LocalisingMemory, PlanningMemory, Walked
from dirl.models.localising import Places
from dirl.recognition.recogniser import Recogniser
from dirl.recognition.tables import VisitScores

Memory = EpisodicMemory | PlanningMemory | LocalisingMemory

Around = Callable[[Tensor], tuple[Tensor, Tensor]]
"""Of the chosen agents, bool ``[B]``, the policy's logits facing each of the four views, float32 ``[B, 4, 4]``, and
whether the goal is seen there, bool ``[B, 4]``; rows of agents that are not chosen are zero."""


class Sight(Protocol):
    """What B agents have seen in their episodes. A *node* is a visit and a heading: ``4 * visit + quarters``."""

    @property
    def seen(self) -> Tensor | None:
        """The visits, ``[B, T, 4, ...]``; None before the first one."""

    def compare(self, visit: Tensor) -> Tensor:
        """How much what is seen now looks like each node so far, float32 ``[B, T, 4]``; the visit becomes the next.

        Args:
            visit: what is seen ahead, right, back and left, in the form of this sight, ``[B, 4, ...]``.
        """

    def select(self, chosen: Tensor) -> None:
        """Keep some of the agents, by mask or index."""


class WorldSight:
    """Visits of a world by their view ids, int64 ``[B, 4]``; scores are looked up.

    Args:
        scores: between any two visits of a scene.
        agents: how many begin, B.
        seen: in an earlier walk through the place, int64 ``[1, T, 4]``.
    """

    def __init__(self, scores: VisitScores, agents: int, seen: Tensor | None = None) -> None:
        self.scores = scores
        if seen is None:
            seen = torch.empty((1, 0, VIEWS), dtype=torch.int64, device=scores.table.device)
        self.seen = seen.expand(agents, -1, -1)

    def compare(self, visit: Tensor) -> Tensor:
        """See `Sight.compare`."""
        found = self.scores(self.seen, visit[:, None, :1])  # a node faces the view that was ahead or aside
        self.seen = torch.cat([self.seen, visit[:, None]], 1)
        return found

    def select(self, chosen: Tensor) -> None:
        """Keep some of the agents."""
        self.seen = self.seen[chosen]


class CameraSight:
    """Visits by the descriptions of their views, float32 ``[B, 4, F]``; scores are computed.

    Args:
        recogniser: compares them.
        seen: in an earlier walk through the place, float32 ``[B, T, 4, F]``.
    """

    def __init__(self, recogniser: Recogniser, seen: Tensor | None = None) -> None:
        self.recogniser = recogniser
        self.seen: Tensor | None = seen

    def compare(self, visit: Tensor) -> Tensor:
        """See `Sight.compare`."""
        seen = visit[:, None][:, :0] if self.seen is None else self.seen
        # An agent that turned right since a visit sees the same views rolled by minus one: rolled back they are alike.
        facing = torch.stack([visit.roll(quarters, 1) for quarters in range(VIEWS)], 1)
        self.seen = torch.cat([seen, visit[:, None]], 1)
        return self.recogniser.scores(seen, facing) if seen.shape[1] else seen.new_zeros(len(visit), 0, VIEWS)

    def select(self, chosen: Tensor) -> None:
        """Keep some of the agents."""
        assert self.seen is not None
        self.seen = self.seen[chosen]


class Counting:
    """The logits of agents with an `EpisodicMemory`.

    Args:
        memory: lowers the logits of actions that were taken before.
        sight: empty.
    """

    def __init__(self, memory: EpisodicMemory, sight: Sight) -> None:
        self.memory, self.sight, self.action = memory, sight, torch.empty(0)
        self.trace = memory.begin(0)
        self.visits = 0

    def adjust(self, visit: Tensor, logits: Callable[[], Tensor], around: Around) -> Tensor:
        """The logits, lowered for what was done where everything looked as it does now.

        Args:
            visit: what is seen, see `Sight.compare`.
            logits: gives those of the policy, float32 ``[B, 4]``.
            around: not used.
        """
        alike = self.sight.compare(visit)[..., 0] > self.memory.threshold
        if not self.visits:
            self.trace = self.memory.begin(len(visit), visit.device)
        else:
            place = torch.full((len(visit),), self.visits, device=visit.device)
            self.trace = self.memory.record(self.trace, place - 1, self.action, place, ~alike[:, -1])
        self.visits += 1
        here = torch.cat([alike, alike.new_ones(len(alike), 1)], 1)
        return self.memory.adjust(logits(), self.trace, here.gather(1, self.trace.place))

    def acted(self, action: Tensor) -> None:
        """Note the actions that the agents take now, int64 ``[B]``."""
        self.action = action

    def select(self, chosen: Tensor) -> None:
        """Keep some of the agents, by mask or index."""
        self.trace, self.action = self.trace.select(chosen), self.action[chosen]
        self.sight.select(chosen)


class Planning:
    """The logits of agents with a `PlanningMemory`.

    Args:
        memory: plans.
        sight: empty.
        turns: in a full circle, int64 ``[B]``, or ``[1]`` if all agents have the same.
    """

    def __init__(self, memory: PlanningMemory, sight: Sight, turns: Tensor) -> None:
        self.memory, self.sight, self.turns = memory, sight, turns
        self.walked: Walked | None = None

    def adjust(self, visit: Tensor, logits: Callable[[], Tensor], around: Around) -> Tensor:
        """The logits of the plan, float32 ``[B, 4]``; see `Counting.adjust`.

        Args:
            visit: what is seen, see `Sight.compare`.
            logits: not used: those of the policy facing ahead are among ``around``.
            around: asks the policy at places that are new.
        """
        walked = self.memory.begin(self.turns.expand(len(visit))) if self.walked is None else self.walked
        same = (self.sight.compare(visit).flatten(1) > self.memory.threshold) & walked.used
        self.walked = self.memory.arrive(walked, same, *around(~same.any(1)))
        return self.memory.plan(self.walked)

    def acted(self, action: Tensor) -> None:
        """Note the actions that the agents take now, int64 ``[B]``."""
        assert self.walked is not None
        self.walked.action = action

    def select(self, chosen: Tensor) -> None:
        """Keep some of the agents, by mask or index."""
        assert self.walked is not None
        self.walked = self.walked.select(chosen)
        self.sight.select(chosen)


class Localising:
    """Agents with a `LocalisingMemory`, which decides where they stop too.

    Args:
        memory: localises and plans.
        sight: empty, or with what was seen on a walk; its recogniser gives log odds.
        places: of that walk, see `dirl.agent.mapping.places.PlaceMap.begin`.
    """

    def __init__(self, memory: LocalisingMemory, sight: Sight, places: Places | None = None) -> None:
        self.memory, self.sight, self.places = memory, sight, places

    def arrive(self, visit: Tensor, goal: Tensor, logits: Callable[[Tensor], Tensor]) -> Tensor:
        """Take in what the agents see; whether they stop there, bool ``[B]``.

        Args:
            visit: what is seen, see `Sight.compare`.
            goal: log odds that it is the goal, facing each of the four views, float32 ``[B, 4]``.
            logits: of the chosen agents, those of the policy facing each view; see `LocalisingMemory.arrive`.
        """
        before = self.memory.begin(len(visit), visit.device) if self.places is None else self.places
        self.places = self.memory.arrive(before, self.sight.compare(visit), goal, logits)
        return self.memory.stops(self.places)

    def plan(self) -> Tensor:
        """The logits of the plan, float32 ``[B, 4]``."""
        assert self.places is not None
        return self.memory.plan(self.places)

    def acted(self, action: Tensor) -> None:
        """Note the actions that the agents take now, int64 ``[B]``."""
        assert self.places is not None
        self.places.action = action

    def select(self, chosen: Tensor) -> None:
        """Keep some of the agents, by mask or index."""
        assert self.places is not None
        self.places = self.places.select(chosen)
        self.sight.select(chosen)


Recall = Counting | Planning | Localising


def recalling(memory: Memory, sight: Sight, turns: Tensor) -> Recall:
    """A memory at the start of B episodes, of agents with so many turns in a full circle, int64 ``[B]`` or ``[1]``."""
    if isinstance(memory, LocalisingMemory):
        return Localising(memory, sight)
    return Planning(memory, sight, turns) if isinstance(memory, PlanningMemory) else Counting(memory, sight)
