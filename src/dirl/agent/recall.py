"""Episodic memories of agents that walk in a world: states whose views match are the same place."""

import torch
from torch import Tensor

from dirl.agent.decisions import Decide
from dirl.envs import SurroundingViews
from dirl.models import EpisodicMemory, PlanningMemory
from dirl.recognition.matching import look_alike
from dirl.scenes import World

Memory = EpisodicMemory | PlanningMemory


class Counting:
    """The logits of agents with an `EpisodicMemory`.

    Args:
        memory: lowers the logits of actions that were taken before.
        world: where they walk.
        decide: the policy's logits.
    """

    def __init__(self, memory: EpisodicMemory, world: World, decide: Decide) -> None:
        self.memory, self.decide, self.device = memory, decide, world.device
        self.alike, self.row = look_alike(world, memory.threshold)

    def begin(self, agents: int) -> None:
        """Begin new episodes."""
        self.trace = self.memory.begin(agents, self.device)

    def __call__(self, episode: Tensor, state: Tensor, view_ids: Tensor, wanted: Tensor) -> Tensor:
        """The adjusted logits; see `dirl.agent.decisions.Decide`."""
        same = self.alike[self.row[self.trace.place] + state.unsqueeze(-1)]
        return self.memory.adjust(self.decide(episode, state, view_ids, wanted), self.trace, same)

    def record(self, before: Tensor, action: Tensor, after: Tensor, going: Tensor) -> None:
        """Note a step of all agents, and keep those that go on, bool ``[B]``."""
        moved = ~self.alike[self.row[before] + after]
        self.trace = self.memory.record(self.trace, before, action, after, moved).select(going)


class Planning:
    """The logits of agents with a `PlanningMemory`.

    Args:
        memory: plans.
        world: where they walk.
        decide: the policy's logits.
        observation: what it observes; see `dirl.envs.SurroundingViews`.
        stop: where agents stop, see `dirl.evaluation.episodes.run_episodes`.
    """

    def __init__(
        self,
        memory: PlanningMemory,
        world: World,
        decide: Decide,
        observation: SurroundingViews,
        stop: Tensor | None,
    ) -> None:
        self.memory, self.world, self.decide, self.observation, self.stop = memory, world, decide, observation, stop
        self.alike, self.row = look_alike(world, memory.threshold)

    def begin(self, agents: int) -> None:
        """Begin new episodes."""
        self.walked = self.memory.begin(agents, self.world.device)
        self.states = torch.empty((agents, 0), dtype=torch.int64, device=self.world.device)
        """Of the nodes, int64 ``[B, N]``."""

    def __call__(self, episode: Tensor, state: Tensor, view_ids: Tensor, wanted: Tensor) -> Tensor:
        """The logits of the plan; see `dirl.agent.decisions.Decide`."""
        same = self.alike[self.row[self.states] + state.unsqueeze(-1)] & self.walked.used
        around = self.world.surrounding[state]
        new = ~same.any(1)
        facing, wanted_there = around[new].flatten(), wanted[new].repeat_interleave(around.shape[1])
        logits = torch.zeros((*around.shape, around.shape[1]), device=state.device)
        asked = episode[new].repeat_interleave(around.shape[1]), facing, self.observation.begin(facing), wanted_there
        logits[new] = self.decide(*asked).view(-1, *logits.shape[1:])
        goal = torch.zeros_like(around, dtype=torch.bool)
        goal[new] = self._is_goal(wanted_there, facing).view(-1, around.shape[1])
        self.walked = self.memory.arrive(self.walked, same, logits, goal)
        self.states = torch.cat([self.states, around], 1)
        return self.memory.plan(self.walked)

    def _is_goal(self, wanted: Tensor, state: Tensor) -> Tensor:
        return state == self.world.goals[wanted] if self.stop is None else self.stop[self.world.pair(wanted, state)]

    def record(self, before: Tensor, action: Tensor, after: Tensor, going: Tensor) -> None:
        """Note a step of all agents, and keep those that go on, bool ``[B]``."""
        self.walked.action = action
        self.walked, self.states = self.walked.select(going), self.states[going]


def recalling(
    memory: Memory, world: World, decide: Decide, observation: SurroundingViews, stop: Tensor | None
) -> Counting | Planning:
    """A memory at the start of episodes in a world; see `Counting` and `Planning`."""
    if isinstance(memory, PlanningMemory):
        return Planning(memory, world, decide, observation, stop)
    return Counting(memory, world, decide)
