"""Episodes of a policy in a world: from given starts, until it stops, without rewards."""

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor, nn
from tqdm import tqdm

from dirl.envs import SurroundingViews
from dirl.envs.transforms import VIEWS
from dirl.models import frozen, initial_state, recurrent_keys
from dirl.models.fast.caching import EmbeddingCache, pack, unpack
from dirl.scenes import ACTIONS, World

PAIRS_AT_ONCE = 16_384

MANY = 50_000
"""Agents for more than which actions are drawn by one random number each, where `torch.multinomial` draws four."""

Decide = Callable[[Tensor, Tensor, Tensor, Tensor], Tensor]
"""Of B agents the episode, state, view ids ``[B, 4]`` and goal index, int64, to logits ``[B, 4]``."""


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
    goal_index, start = world.pairs()
    reaches = world.distances > 0
    return goal_index[reaches], start[reaches]


def sampled_starts(world: World, per_goal: int, seed: int) -> tuple[Tensor, Tensor]:
    """``per_goal`` starts for each goal, drawn uniformly with replacement, as in the paper's section 4.5.2."""
    generator = torch.Generator().manual_seed(seed)
    drawn = []
    for index, offset in enumerate(world.offsets):
        reaches = torch.stack([world.block(world.distances, goal) > 0 for goal in world.goals_in(index)])
        starts = torch.multinomial(reaches.float().cpu(), per_goal, replacement=True, generator=generator)
        drawn.append(starts.flatten() + offset)
    goal_index = torch.arange(len(world.goals)).repeat_interleave(per_goal)
    return goal_index.to(world.device), torch.cat(drawn).to(world.device)


def shortest_episodes(world: World, starts: tuple[Tensor, Tensor]) -> Episodes:
    """The expert's episodes from given starts, without walking them: it never fails and never errs."""
    goal_index, start = starts
    shortest = world.distance(goal_index, start)
    never = torch.zeros_like(start, dtype=torch.bool)
    return Episodes(goal_index, start, shortest, shortest, ~never, never, never)


@torch.no_grad()
def run_episodes(
    policy: nn.Module,
    world: World,
    starts: tuple[Tensor, Tensor],
    *,
    observation: SurroundingViews,
    stop: Tensor | None = None,
    max_steps: int = 200,
    greedy: bool = True,
    seed: int = 0,
    watch: Callable[[Tensor, Tensor], None] | None = None,
) -> Episodes:
    """One episode from each start.

    This is no TorchRL rollout because finished episodes leave the batch, which an ``EnvBase`` cannot do, and because
    a policy without memory is asked once for all agents that observe the same on the way to the same goal.

    Args:
        policy: reads a tensordict and writes ``logits``; with memory also its next recurrent state.
        world: where.
        starts: goal indices and start states, int64 ``[E]`` each, see `every_start`.
        observation: the transform that the policy was trained with.
        stop: where an agent stops, bool ``[P]``, see `World.pair`; at the goal itself if left out.
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
    state, view_ids = start, observation.begin(start)
    often = 0.2 if sys.stderr.isatty() else 10.0
    few = len(start) <= MANY
    bar = tqdm(total=len(start), unit=" episodes", unit_scale=True, leave=False, mininterval=often, disable=few)
    with frozen(policy), bar:
        decide = deciding(policy, world, observation, len(start))
        for step in range(1, max_steps + 1):
            wanted = goal_index[walking]
            action = choose(decide(walking, state, view_ids, wanted), generator, greedy=greedy)
            state = world.graph[state, action]
            if watch is not None:
                watch(walking, state)
            at_goal = state == world.goals[wanted]
            stopped = at_goal if stop is None else stop[world.pair(wanted, state)]
            success[walking] = stopped & at_goal
            false_stop[walking] = stopped & ~at_goal
            missed_stop[walking] |= at_goal & ~stopped
            steps[walking[stopped & at_goal]] = step
            going = ~stopped
            if not going.any():
                break
            view_ids = observation.follow(view_ids, state)[going]
            walking, state = walking[going], state[going]
            if not few:
                bar.update(len(start) - len(walking) - bar.n)
    shortest = world.distance(goal_index, start)
    return Episodes(goal_index, start, shortest, steps, success, false_stop, missed_stop)


def choose(logits: Tensor, generator: torch.Generator, *, greedy: bool) -> Tensor:
    """The most probable action, or one drawn by its probability, of logits ``[B, 4]``; int64 ``[B]``."""
    if greedy:
        return logits.argmax(-1)
    probabilities = logits.softmax(-1)
    if len(logits) <= MANY:
        return torch.multinomial(probabilities, 1, generator=generator).squeeze(-1)
    drawn = torch.rand((len(logits), 1), generator=generator, device=logits.device)
    # The last bound is 1 up to rounding, and must not let a number beyond it.
    return (drawn >= probabilities.cumsum(-1)[:, :-1]).sum(-1)


def deciding(policy: nn.Module, world: World, observation: SurroundingViews, episodes: int) -> Decide:
    """A function of where agents are that gives their logits, asking the policy as little as possible.

    A policy without memory on views of its surroundings has one answer for each pair of goal and state: all are asked
    beforehand. On views with a history every distinct case is asked once, when it comes up. A policy with memory is
    asked at every step.
    """
    if recurrent_keys(policy):
        return _with_memory(policy, world, observation, episodes)
    if observation.history:
        return _once_a_case(policy, world, observation)
    table, _ = answers(policy, world, observation)
    return lambda episode, state, view_ids, wanted: table.index_select(0, world.pair(wanted, state))


def _once_a_case(policy: nn.Module, world: World, observation: SurroundingViews) -> Decide:
    states, goals = len(world), len(world.goals)
    seen, answered = EmbeddingCache(), EmbeddingCache()

    def decide(episode: Tensor, state: Tensor, view_ids: Tensor, wanted: Tensor) -> Tensor:
        row = seen.places(pack(view_ids, states), lambda keys: (unpack(keys, states, VIEWS),))

        def answer(cases: Tensor) -> tuple[Tensor]:
            goal, ids = cases % goals, seen.rows[0][cases // goals]
            return (policy(observe(world, observation, ids[:, -1], ids, goal))["logits"],)

        place = answered.places(row * goals + wanted, answer)
        return answered.rows[0][place]

    return decide


def _with_memory(policy: nn.Module, world: World, observation: SurroundingViews, episodes: int) -> Decide:
    memory = initial_state(policy, episodes, world.device)
    begins = torch.ones((episodes, 1), dtype=torch.bool, device=world.device)

    def decide(episode: Tensor, state: Tensor, view_ids: Tensor, wanted: Tensor) -> Tensor:
        asked = observe(world, observation, state, view_ids, wanted)
        asked.update({"is_init": begins[episode], **{key: value[episode] for key, value in memory.items()}})
        logits: Tensor = policy(asked)["logits"]
        for key, value in memory.items():
            value[episode] = asked["next", key]
        begins[episode] = False
        return logits

    return decide


def observe(
    world: World, observation: SurroundingViews, state: Tensor, view_ids: Tensor, goal_index: Tensor
) -> TensorDict:
    """What a policy reads, ``[B]``: state, goal, scene, and the view ids of both."""
    goal = world.goals[goal_index]
    return TensorDict(
        {
            "state": state,
            "goal": goal,
            "scene": world.scene_of[goal],
            "view_ids": view_ids,
            "goal_view_ids": observation.begin(goal),
        },
        batch_size=[len(state)],
    )


@torch.no_grad()
def answers(
    policy: nn.Module, world: World, observation: SurroundingViews, goal_index: int | None = None
) -> tuple[Tensor, Tensor]:
    """What a policy makes of every pair of a goal and a state of its scene.

    Views that hold a history are those at the start of an episode, and so is a memory. Asked for all goals, the policy
    is asked in the same batches as by `run_episodes`, so that the rounding, too, is the same.

    Args:
        policy: see `run_episodes`.
        world: where.
        observation: what the policy observes.
        goal_index: one goal by its place in ``world.goals``; all of them if left out.

    Returns:
        Logits, float32 ``[P, 4]``, and state values, ``[P]``, zero if the policy has none; of one goal, of the states
        of its scene only.
    """
    goals, states = world.pairs()
    if goal_index is not None:
        goals, states = world.block(goals, goal_index), world.block(states, goal_index)
    logits = torch.zeros((len(goals), len(ACTIONS)), device=world.device)
    values = torch.zeros(len(goals), device=world.device)
    with frozen(policy):
        for place, wanted, state in _batches(goals, states):
            asked: Any = observe(world, observation, state, observation.begin(state), wanted)
            asked["is_init"] = torch.ones((len(state), 1), dtype=torch.bool, device=world.device)
            asked.update(initial_state(policy, len(state), world.device))
            answered = policy(asked)
            logits[place] = answered["logits"]
            if "state_value" in answered:
                values[place] = answered["state_value"].squeeze(-1)
    return logits, values


def _batches(goals: Tensor, states: Tensor) -> Iterator[tuple[slice, Tensor, Tensor]]:
    """`PAIRS_AT_ONCE` pairs at a time, and their places."""
    for first in range(0, len(goals), PAIRS_AT_ONCE):
        place = slice(first, first + PAIRS_AT_ONCE)
        yield place, goals[place], states[place]
