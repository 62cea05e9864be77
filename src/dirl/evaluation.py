"""How well a policy navigates: episodes from given starts, and their ATL, SR and SPL (paper section 4.3)."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from dirl.envs import SurroundingViews
from dirl.envs.transforms import VIEWS
from dirl.models import Network
from dirl.models.fast.caching import Memory, pack, unpack
from dirl.scenes import ACTIONS, World

Policy = Callable[[Tensor, Tensor, Tensor], Tensor]
"""Views and goal views, int64 ``[B, 4]``, and scene, int64 ``[B]``, to logits ``[B, 4]``."""

ASKED_AT_ONCE = 16_384


@dataclass(frozen=True, eq=False)
class Episodes:
    """What became of E episodes; every tensor is ``[E]``."""

    goal_index: Tensor
    """The goal, by its place in ``world.goals``, int64."""
    start: Tensor
    """The state it began in, int64."""
    shortest: Tensor
    """Fewest actions from there to the goal, int64."""
    steps: Tensor
    """Actions taken, int64; the limit where the goal was not reached, or not recognised."""
    success: Tensor
    """The agent stopped at the goal, bool."""
    false_stop: Tensor
    """It stopped elsewhere, bool."""
    missed_stop: Tensor
    """It stood at the goal at least once without stopping, bool."""

    def select(self, chosen: Tensor) -> "Episodes":
        """Some of the episodes, by mask or index."""
        return Episodes(*(value[chosen] for value in vars(self).values()))


def every_start(world: World) -> tuple[Tensor, Tensor]:
    """Each goal with each state that reaches it and is not it: goal index and start, int64 ``[E]`` each."""
    goal_index, start = torch.nonzero(world.distances > 0, as_tuple=True)
    return goal_index, start


def sampled_starts(world: World, per_goal: int, seed: int) -> tuple[Tensor, Tensor]:
    """``per_goal`` starts for each goal, drawn uniformly with replacement, as in the paper's section 4.5.2."""
    generator = torch.Generator().manual_seed(seed)
    draws = torch.multinomial((world.distances > 0).float().cpu(), per_goal, replacement=True, generator=generator)
    goal_index = torch.arange(len(world.goals)).repeat_interleave(per_goal)
    return goal_index.to(world.device), draws.flatten().to(world.device)


def mean_shortest(world: World) -> list[float]:
    """The fewest steps to each goal, in the mean over the states that reach it."""
    return [distances[distances > 0].double().mean().item() for distances in world.distances]


def shortest_episodes(world: World, starts: tuple[Tensor, Tensor]) -> Episodes:
    """The expert's episodes from given starts, without walking them: it never fails and never errs."""
    goal_index, start = starts
    shortest = world.distances[goal_index, start]
    never = torch.zeros_like(start, dtype=torch.bool)
    return Episodes(goal_index, start, shortest, shortest, ~never, never, never)


def random_policy(views: Tensor, goal_views: Tensor, scene: Tensor) -> Tensor:
    """Each of the four actions with the same probability, the paper's random baseline."""
    return torch.zeros((len(views), len(ACTIONS)), device=views.device)


@torch.no_grad()
def run_episodes(
    policy: Policy,
    world: World,
    starts: tuple[Tensor, Tensor],
    *,
    sight: SurroundingViews,
    stop: Tensor | None = None,
    max_steps: int = 200,
    greedy: bool = True,
    seed: int = 0,
    watch: Callable[[Tensor, Tensor], None] | None = None,
) -> Episodes:
    """One episode from each start.

    This is no TorchRL rollout because finished episodes leave the batch, which an ``EnvBase`` cannot do, and because
    agents that see the same and want the same are asked once for all.

    Args:
        policy: what to evaluate.
        world: where.
        starts: goal indices and start states, int64 ``[E]`` each, see `every_start`.
        sight: what the policy sees, the transform it was trained with.
        stop: where an agent stops, bool ``[G, N]``; at the goal itself if left out.
        max_steps: an episode that has not reached its goal by then has failed.
        greedy: take the most probable action (of equal ones the first), else draw one.
        seed: of the draws.
        watch: called after each step with the episodes still going on and their states, int64 ``[W]`` each.
    """
    goal_index, start = starts
    generator = torch.Generator(world.device).manual_seed(seed)
    steps = torch.full_like(start, max_steps)
    success, false_stop, missed_stop = (torch.zeros_like(start, dtype=torch.bool) for _ in range(3))
    walking = torch.arange(len(start), device=world.device)
    state, views = start, sight.begin(start)
    ask = _asking(policy, world, sight)
    for step in range(1, max_steps + 1):
        wanted = goal_index[walking]
        logits = ask(state, views, wanted)
        if greedy:
            action = logits.argmax(-1)
        else:
            action = torch.multinomial(logits.softmax(-1), 1, generator=generator).squeeze(-1)
        state = world.graph[state, action]
        if watch is not None:
            watch(walking, state)
        at_goal = state == world.goals[wanted]
        stopped = at_goal if stop is None else stop[wanted, state]
        success[walking] = stopped & at_goal
        false_stop[walking] = stopped & ~at_goal
        missed_stop[walking] |= at_goal & ~stopped
        steps[walking[stopped & at_goal]] = step
        going = ~stopped
        if not going.any():
            break
        views = sight.follow(views, state)[going]
        walking, state = walking[going], state[going]
    shortest = world.distances[goal_index, start]
    return Episodes(goal_index, start, shortest, steps, success, false_stop, missed_stop)


def _asking(policy: Policy, world: World, sight: SurroundingViews) -> Callable[[Tensor, Tensor, Tensor], Tensor]:
    """State, views and goal index of B agents to the policy's logits ``[B, 4]``, asking as little as possible.

    Where the history does not matter there are only so many pairs of state and goal, and all are asked beforehand;
    else every distinct pair of views and goal is asked once, when it comes up.
    """
    goal_views = sight.begin(world.goals)
    goals = len(world.goals)
    if not sight.history:
        table = torch.zeros((*world.distances.shape, len(ACTIONS)), device=world.device)
        for wanted, seen in _pairs(world, world.goals):
            table[wanted, seen] = policy(sight.begin(seen), goal_views[wanted], world.scene_of[seen])
        return lambda state, views, wanted: table[wanted, state]

    states, sights, answered = len(world), Memory(), Memory()

    def ask(state: Tensor, views: Tensor, wanted: Tensor) -> Tensor:
        row = sights.places(pack(views, states), lambda keys: (unpack(keys, states, VIEWS),))

        def answer(cases: Tensor) -> tuple[Tensor]:
            goal = cases % goals
            return (policy(sights.rows[0][cases // goals], goal_views[goal], world.scene_of[world.goals[goal]]),)

        case = answered.places(row * goals + wanted, answer)
        return answered.rows[0][case]

    return ask


def evaluate(network: Network, world: World, starts: tuple[Tensor, Tensor], **options: Any) -> Episodes:
    """`run_episodes` with a network as the policy; its encoder embeds each view once for all episodes."""
    with network.encoder.projecting():
        return run_episodes(lambda *seen: network(*seen)[0], world, starts, **options)


def trajectories(
    network: Network, world: World, starts: tuple[Tensor, Tensor], **options: Any
) -> tuple[Episodes, list[list[int]]]:
    """`evaluate`, and the states that each episode passed, from its start to its last state."""
    paths = [[state] for state in starts[1].tolist()]

    def watch(walking: Tensor, state: Tensor) -> None:
        for episode, passed in zip(walking.tolist(), state.tolist(), strict=True):
            paths[episode].append(passed)

    return evaluate(network, world, starts, watch=watch, **options), paths


@torch.no_grad()
def answers(
    network: Network, world: World, sight: SurroundingViews, goal_index: Tensor | None = None
) -> tuple[Tensor, Tensor]:
    """What a network makes of every state on its way to each goal: logits ``[G, N, 4]`` and state values ``[G, N]``.

    Views that hold a history are those at the start of an episode. Asked for all goals, the network is asked in the
    same batches as by `run_episodes`, so that the rounding, too, is the same.

    Args:
        network: whose policy and value.
        world: where.
        sight: what the network sees.
        goal_index: int64 ``[G]``, goals by their place in ``world.goals``; all of them if left out.

    Returns:
        float32, zero for states of other scenes than the goal's.
    """
    goals = world.goals if goal_index is None else world.goals[goal_index]
    goal_views = sight.begin(goals)
    logits = torch.zeros((len(goals), len(world), len(ACTIONS)), device=world.device)
    values = torch.zeros((len(goals), len(world)), device=world.device)
    with network.encoder.projecting():
        for wanted, seen in _pairs(world, goals):
            found, value = network(sight.begin(seen), goal_views[wanted], world.scene_of[seen])
            logits[wanted, seen], values[wanted, seen] = found, value.squeeze(-1)
    return logits, values


def action_values(network: Network, world: World, sight: SurroundingViews, goal_index: int) -> tuple[Tensor, Tensor]:
    """Probabilities ``[N, 4]`` and state value ``[N]`` on the way to one goal, in its scene's states; see `answers`."""
    logits, values = answers(network, world, sight, torch.tensor([goal_index], device=world.device))
    inside = world.scene_of == world.scene_of[world.goals[goal_index]]
    return logits[0, inside].softmax(-1), values[0, inside]


def _pairs(world: World, goals: Tensor) -> Iterator[tuple[Tensor, Tensor]]:
    """Each goal (by its place in ``goals``) with each state of its scene, int64 ``[P]`` each, batch by batch."""
    goal_index, state = torch.nonzero(world.scene_of[goals].unsqueeze(1) == world.scene_of, as_tuple=True)
    return zip(goal_index.split(ASKED_AT_ONCE), state.split(ASKED_AT_ONCE), strict=True)


def metrics(episodes: Episodes) -> dict[str, float]:
    """The measures of the paper's section 4.3, over all episodes unless said otherwise.

    ``atl``: steps, with the limit for failures; ``atl_success``: steps of the successful ones (NaN if there are
    none); ``sr``: share that stopped at the goal; ``spl``: success weighted by shortest/steps; ``shortest``: fewest
    possible steps; ``false_stop_rate`` and ``missed_stop_rate``: shares; ``episodes``: how many.
    """
    success = episodes.success.double()
    steps, shortest = episodes.steps.double(), episodes.shortest.double()
    return {
        "atl": steps.mean().item(),
        "atl_success": steps[episodes.success].mean().item(),
        "sr": success.mean().item(),
        "spl": (success * shortest / torch.maximum(steps, shortest)).mean().item(),
        "shortest": shortest.mean().item(),
        "false_stop_rate": episodes.false_stop.double().mean().item(),
        "missed_stop_rate": episodes.missed_stop.double().mean().item(),
        "episodes": len(steps),
    }


def report(episodes: Episodes, world: World) -> dict[str, Any]:
    """`metrics` overall; under ``scenes`` those of each scene, and under its ``goals`` those of each goal's state."""
    summary: dict[str, Any] = {**metrics(episodes), "scenes": {}}
    for index, goal in enumerate(world.goals.tolist()):
        scene, local = world.local(goal)
        if scene.name not in summary["scenes"]:
            inside = world.scene_of[episodes.start] == world.scene_of[goal]
            summary["scenes"][scene.name] = {**metrics(episodes.select(inside)), "goals": {}}
        of_goal = episodes.select(episodes.goal_index == index)
        summary["scenes"][scene.name]["goals"][str(local)] = metrics(of_goal)
    return summary
