"""The shortest-path expert and the demonstrations taken from it (paper sections 3.3 and 4.2)."""

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from dirl.scenes import World
from dirl.scenes.graph import places

RULES = ("interval", "interval_pos", "random")


def optimal_actions(world: World, goal_index: Tensor, state: Tensor) -> Tensor:
    """Which actions are the first of a shortest path.

    Args:
        world: where to walk.
        goal_index: int64 ``[B]``, the goals by their place in ``world.goals``.
        state: int64 ``[B]``, states that reach them and are not the goals themselves.

    Returns:
        bool ``[B, 4]``.
    """
    after = world.distances[goal_index.unsqueeze(-1), world.graph[state]]
    return after == world.distances[goal_index, state].unsqueeze(-1) - 1


def expert_action(world: World, goal_index: Tensor, state: Tensor) -> Tensor:
    """The expert's choice, int64 ``[B]``: of several optimal actions the first in the order of `ACTIONS`."""
    return optimal_actions(world, goal_index, state).int().argmax(-1)


def demonstration_states(place: Tensor, share: float, rule: str, generator: torch.Generator) -> Tensor:
    """Which states of a scene the expert shows.

    Args:
        place: the place of each state, int64 ``[N]``, numbered from 0.
        share: of the states to show, 0 to 1.
        rule: ``interval``, every k-th state by its number, as the paper says (with four headings a place and an
            even k that is only ever one or two headings); ``interval_pos``, every k-th place with all its headings;
            ``random``, drawn without replacement. k is 1/share, rounded.
        generator: for ``random``.

    Returns:
        bool ``[N]``.

    Raises:
        ValueError: the share is not in [0, 1], or there is no such rule.
    """
    if not 0 <= share <= 1:
        raise ValueError(f"the share of demonstrated states is between 0 and 1, not {share}")
    if rule not in RULES:
        raise ValueError(f"there is no rule '{rule}' to choose demonstrations; choose one of {list(RULES)}")
    states = len(place)
    if share == 0:
        return torch.zeros(states, dtype=torch.bool)
    if rule == "random":
        shown = torch.zeros(states, dtype=torch.bool)
        shown[torch.randperm(states, generator=generator)[: max(1, round(share * states))]] = True
        return shown
    every = round(1 / share)
    return (torch.arange(states) if rule == "interval" else place) % every == 0


def demonstrations(world: World, share: float, rule: str = "interval", seed: int = 0) -> TensorDict:
    """The expert's actions in a share of each scene's states, for every goal of the scene.

    States that do not reach a goal, and the goal itself, are left out for that goal.

    Args:
        world: where to walk.
        share: of the states, 0 to 1.
        rule: how they are chosen, see `demonstration_states`.
        seed: of the choice.

    Returns:
        ``[M]`` rows of ``state``, ``goal``, ``scene`` and ``expert_action``, all int64.
    """
    generator = torch.Generator().manual_seed(seed)
    shown = [
        demonstration_states(torch.from_numpy(places(scene.graph)), share, rule, generator) for scene in world.scenes
    ]
    shows = (world.distances > 0) & torch.cat(shown).to(world.device)
    goal_index, state = torch.nonzero(shows, as_tuple=True)
    return TensorDict(
        {
            "state": state,
            "goal": world.goals[goal_index],
            "scene": world.scene_of[state],
            "expert_action": expert_action(world, goal_index, state),
        },
        batch_size=[len(state)],
        device=world.device,
    )


def label(world: World, visited: TensorDictBase) -> TensorDict:
    """What the expert would do where a learner has come to.

    Args:
        world: where it walks.
        visited: ``[B]`` rows of ``state``, ``goal`` and ``scene``, and the views of both.

    Returns:
        ``[M]`` rows of the same and ``expert_action``. Left out are states that do not reach their goal.
    """
    wanted = world.goal_index[visited["goal"]]
    reaches = world.distances[wanted, visited["state"]] > 0
    rows = visited.select("state", "goal", "scene", "views", "goal_views")[reaches].clone()
    return rows.set("expert_action", expert_action(world, wanted[reaches], rows["state"]))


def merge_demonstrations(*parts: TensorDictBase) -> TensorDictBase:
    """All demonstrations, one of each that see the same on the way to the same goal; in order of these."""
    rows = TensorDict.cat(
        [part.select("state", "goal", "scene", "views", "goal_views", "expert_action") for part in parts]
    )
    seen = torch.cat([rows["views"], rows["goal"].unsqueeze(-1)], -1)
    _, which = torch.unique(seen, dim=0, return_inverse=True)
    first = torch.full((int(which.max()) + 1,), len(which), device=which.device)
    first.scatter_reduce_(0, which, torch.arange(len(which), device=which.device), "amin")
    return rows[first]
