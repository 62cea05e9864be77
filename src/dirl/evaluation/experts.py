"""Experts, and the demonstrations taken from them (paper section 3.3)."""

from typing import ClassVar

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from dirl.agent.decisions import observe
from dirl.envs import SurroundingViews
from dirl.scenes import ACTIONS
from dirl.scenes.graph import places
from dirl.scenes.world import World

DEMONSTRATED = ("state", "goal", "scene", "view_ids", "goal_view_ids", "expert_action")
"""The keys of a demonstration."""

OPTIONAL = ("optimal_actions",)
"""What it holds besides if the expert writes it."""

LABELS_AT_ONCE = 65_536
"""Rows that an expert is asked for together."""


class ShortestPathExpert(TensorDictModuleBase):
    """Takes a first action of a shortest path: of several the first in the order of `ACTIONS`.

    An expert is any module that reads ``state`` and ``goal``, int64 ``[B]``, and writes ``expert_action``, int64
    ``[B]``: -1 where it has no advice, here at the goal and where the goal cannot be reached. It may also write
    ``optimal_actions``, bool ``[B, 4]``, all actions that it accepts, for
    `dirl.training.objectives.OptimalActionsLoss`.
    """

    in_keys: ClassVar = ["state", "goal"]
    out_keys: ClassVar = ["expert_action", "optimal_actions"]

    def __init__(self, world: World) -> None:
        super().__init__()
        self.world = world

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``expert_action`` and ``optimal_actions``."""
        goal_index, state = self.world.goal_index[tensordict["goal"]], tensordict["state"]
        left = self.world.distance(goal_index, state)
        # The first action of a shortest path leads a step nearer; at the goal, and where none leads there, none is.
        after = self.world.distance(goal_index.unsqueeze(-1), self.world.graph[state])
        optimal = after == left.unsqueeze(-1) - 1
        tensordict["expert_action"] = torch.where(left > 0, optimal.int().argmax(-1), -1)
        return tensordict.set("optimal_actions", optimal)


class ShortestPathPolicy(ShortestPathExpert):
    """The expert as a policy: writes ``logits``, float32 ``[B, 4]``, 0 for its action and -inf for the others."""

    out_keys: ClassVar = ["expert_action", "optimal_actions", "logits"]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``logits``; without advice all actions are equally probable."""
        action = super().forward(tensordict)["expert_action"].unsqueeze(-1)
        chosen = torch.arange(len(ACTIONS), device=action.device) == action
        return tensordict.set("logits", torch.where(chosen | (action < 0), 0.0, -torch.inf))


def shown_states(world: World, fraction: float, rule: str, seed: int) -> Tensor:
    """Return the states of a world that the expert demonstrates, bool ``[N]``, counted scene by scene.

    Args:
        world: the scenes.
        fraction: of the states to demonstrate, 0 to 1.
        rule: ``interval``, every k-th state by its number, as the paper says (with four headings a place and an
            even k that is only ever one or two headings); ``interval_pos``, every k-th place with all its headings;
            ``random``, sampled without replacement. k is 1/fraction, rounded.
        seed: for ``random``.
    """
    generator, parts = torch.Generator().manual_seed(seed), []
    for scene in world.scenes:
        states = len(scene)
        shown = torch.zeros(states, dtype=torch.bool)
        if fraction and rule == "random":
            shown[torch.randperm(states, generator=generator)[: max(1, round(fraction * states))]] = True
        elif fraction:
            number = torch.arange(states) if rule == "interval" else torch.from_numpy(places(scene.graph))
            shown = number % round(1 / fraction) == 0
        parts.append(shown)
    return torch.cat(parts).to(world.device)


def demonstrations(
    world: World,
    expert: TensorDictModuleBase,
    observation: SurroundingViews,
    fraction: float,
    rule: str = "interval",
    seed: int = 0,
) -> TensorDict:
    """Return the expert's actions in a fraction of each scene's states, for every goal of the scene.

    For fraction and rule see `shown_states`. A state without advice for a goal is left out for that goal. A
    demonstrated state has no history: it is observed as the start of an episode.

    Returns:
        ``[M]`` rows of `DEMONSTRATED`, all int64.
    """
    goal_index, state = world.pairs()
    chosen = shown_states(world, fraction, rule, seed)[state]
    goal_index, state = goal_index[chosen], state[chosen]
    return label(expert, observe(world, observation, state, observation.reset_view_ids(state), goal_index))


def label(expert: TensorDictModuleBase, visited: TensorDictBase) -> TensorDictBase:
    """Return the expert's actions in states that were visited, ``[B]`` rows of `DEMONSTRATED` but for the action.

    Returns:
        ``[M]`` rows of `DEMONSTRATED`. Left out are those for which the expert has no advice.
    """
    rows = visited.select(*DEMONSTRATED[:-1]).clone()
    parts = rows.split(LABELS_AT_ONCE) if len(rows) else [rows]  # tensordict does not split an empty one
    rows = TensorDict.cat([expert(part) for part in parts])
    return rows[rows["expert_action"] >= 0].select(*DEMONSTRATED, *OPTIONAL, strict=False)


def merge_demonstrations(*parts: TensorDictBase) -> TensorDictBase:
    """Return all demonstrations, one of each that observe the same on the way to the same goal; in order of these."""
    rows = TensorDict.cat([part.select(*DEMONSTRATED, *OPTIONAL, strict=False) for part in parts])
    # The rank of each row, column by column: twenty times as fast as `torch.unique` of rows.
    which = rows["goal"].new_zeros(len(rows))
    for column in (*rows["view_ids"].unbind(-1), rows["goal"]):
        which = torch.unique(which * (column.max() + 1) + column, return_inverse=True)[1]
    first = torch.full((int(which.max()) + 1,), len(which), device=which.device)
    first.scatter_reduce_(0, which, torch.arange(len(which), device=which.device), "amin")
    return rows[first]
