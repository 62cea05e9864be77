"""Episodes of a policy in a world: from given starts, until it stops, without rewards."""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from tqdm import tqdm

from dirl.agent.agent import MANY, Memory, make_agent
from dirl.agent.decisions import Known, Walk, deciding
from dirl.agent.mapping.places import PlaceMap
from dirl.envs import SurroundingViews
from dirl.evaluation.experts import RandomPolicy
from dirl.models import frozen
from dirl.perception.recognition.matching import Arrived
from dirl.perception.recognition.recogniser import NCC
from dirl.perception.recognition.tables import VisitScores
from dirl.scenes import ACTIONS, World


@dataclass(frozen=True, eq=False)
class Episodes:
    """The outcome of E episodes; every tensor is ``[E]``."""

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
    """``per_goal`` starts for each goal, sampled uniformly with replacement, as in the paper's section 4.5.2."""
    generator = torch.Generator().manual_seed(seed)
    drawn = []
    for index, offset in enumerate(world.offsets):
        reaches = torch.stack([world.block(world.distances, goal) > 0 for goal in world.goals_in(index)])
        starts = torch.multinomial(reaches.float().cpu(), per_goal, replacement=True, generator=generator)
        drawn.append(starts.flatten() + offset)
    goal_index = torch.arange(len(world.goals)).repeat_interleave(per_goal)
    return goal_index.to(world.device), torch.cat(drawn).to(world.device)


def shortest_episodes(world: World, starts: tuple[Tensor, Tensor]) -> Episodes:
    """The expert's episodes from given starts, from the distances alone: the expert never fails."""
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
    stop: Tensor | Arrived | None = None,
    max_steps: int = 200,
    greedy: bool = True,
    seed: int = 0,
    memory: Memory | None = None,
    scores: VisitScores | None = None,
    maps: Sequence[PlaceMap] | None = None,
    looks: range | None = None,
    photos: range | None = None,
    shown: Tensor | None = None,
    watch: Callable[[Tensor, Tensor, Tensor], None] | None = None,
) -> Episodes:
    """One episode from each start. In a world that changes every visit and every goal has a look sampled for it.

    The look of its goal is not sampled for the visits of an episode: no place looks to the bit as in the goal's views.

    This is no TorchRL rollout, for two reasons. Finished episodes leave the batch, which an ``EnvBase`` does not
    support. And a memoryless policy is evaluated once for all agents with the same observation and goal.

    Args:
        policy: reads a tensordict and writes ``logits``; with memory also its next recurrent state.
        world: where.
        starts: goal indices and start states, int64 ``[E]`` each, see `every_start`.
        observation: the transform that the policy was trained with.
        stop: where an agent stops, bool ``[P]``, see `World.pair`, or see
            `dirl.perception.recognition.matching.Arrived`; at the goal itself if left out. With a `LocalisingMemory`
            its log odds, `dirl.perception.recognition.matching.Compared`.
        max_steps: after so many steps an episode has failed.
        greedy: take the most probable action (of equal ones the first), else draw one.
        seed: of the draws.
        memory: changes logits by what was done in the episode, see `EpisodicMemory` and `PlanningMemory`.
        scores: by which the memory knows places; correlation if left out.
        maps: of a walk through each scene, which the episodes go on with; for a `LocalisingMemory`.
        looks: of visits and goals; all if left out.
        photos: looks of goals, if they are others.
        shown: the goal that the policy is shown instead of each goal, int64 ``[G]``; it must be in the same scene.
        watch: called after each step with the unfinished episodes, their states and actions, int64 ``[W]`` each.
    """
    goal_index, start = starts
    never = [torch.zeros_like(start, dtype=torch.bool) for _ in range(3)]
    episodes = Episodes(goal_index, start, world.distance(goal_index, start), torch.full_like(start, max_steps), *never)
    generator = torch.Generator(world.device).manual_seed(seed)
    wanted = drawn_looks(goal_index, len(world.goals), world, generator, looks=photos or looks)
    few = len(start) <= MANY
    bar = tqdm(
        total=len(start), unit=" episodes", unit_scale=True, leave=False, mininterval=bar_interval(), disable=few
    )
    if memory is not None and scores is None:
        scores = VisitScores(NCC(), world)
    with frozen(policy), bar:
        at_random = isinstance(policy, RandomPolicy) and not (greedy or few or memory)
        decide = None if at_random else deciding(policy, world, observation, len(start))
        known = Known(world, observation, decide, _arrived(world, stop), scores, shown)

        def ahead_in(state: Tensor, goals: Tensor) -> Tensor:
            besides = None if photos else goals // len(world.goals)
            return drawn_looks(state, len(world), world, generator, besides, looks)

        for walking in _together(start, world, memory is not None, maps is not None):
            here, goals = start[walking], wanted[walking]
            ahead = ahead_in(here, goals)
            walk = Walk(known, walking, goals, here, ahead, observation.begin(ahead))
            scene = world.scene_of[here]
            map_of_scene = None if maps is None else maps[int(scene[0])]
            agent = make_agent(memory, world.turns[scene], map_of_scene)
            agent.arrive(walk)  # no agent stops before its first step
            for step in range(1, max_steps + 1):
                if at_random:
                    action = torch.randint(len(ACTIONS), walk.state.shape, generator=generator, device=world.device)
                else:
                    action, _ = agent.act(walk, generator, greedy=greedy)
                state = world.graph[walk.state, action]
                walk = walk.after(state, ahead_in(state, walk.wanted))
                stopped = agent.arrive(walk)
                _record(episodes, walk, stopped, step)
                if watch is not None:
                    watch(walk.episode, walk.state, action)
                going = torch.nonzero(~stopped).flatten()
                bar.update(len(stopped) - len(going))
                if not len(going):
                    break
                agent.select(going)
                walk = walk.select(going)
    return episodes


def _record(episodes: Episodes, walk: Walk, stopped: Tensor, step: int) -> None:
    """Note where the agents stopped, bool ``[W]``, or should have."""
    at_goal = walk.state == walk.known.world.goals[episodes.goal_index[walk.episode]]
    episodes.success[walk.episode] = stopped & at_goal
    episodes.false_stop[walk.episode] = stopped & ~at_goal
    episodes.missed_stop[walk.episode] |= at_goal & ~stopped
    episodes.steps[walk.episode[stopped & at_goal]] = step


def _together(start: Tensor, world: World, memory: bool, maps: bool) -> list[Tensor]:
    """The episodes that are walked at the same time, by their places in ``start``."""
    episodes = torch.arange(len(start), device=world.device)
    if maps:
        return [episodes[world.scene_of[start] == scene] for scene in world.scene_of[start].unique()]
    # A memory of many episodes takes much space until they have ended.
    return list(episodes.split(MANY if memory else max(1, len(start))))


def drawn_looks(
    index: Tensor,
    count: int,
    world: World,
    generator: torch.Generator | None = None,
    besides: Tensor | None = None,
    looks: range | None = None,
) -> Tensor:
    """States or goals, int64 ``[B]`` below ``count``, each in a look sampled for it: ``look * count + index``.

    Args:
        index: the states or goals.
        count: how many the world has.
        world: with L looks.
        generator: draws; torch's own if left out.
        besides: looks that are not sampled, int64 ``[B]``: those of the goals, which shall not return to the bit.
        looks: that are sampled from; all L if left out.
    """
    looks = range(world.looks) if looks is None else looks
    if len(looks) == 1:
        return index + looks.start * count
    if besides is None:
        look = looks.start + torch.randint(len(looks), index.shape, generator=generator, device=index.device)
    else:
        others = torch.randint(1, len(looks), index.shape, generator=generator, device=index.device)
        look = looks.start + (besides - looks.start + others) % len(looks)
    return index + count * look


def _arrived(world: World, stop: Tensor | Arrived | None) -> Arrived:
    """Whether agents stop, by a table, a function, or exactly at the goal."""
    states, goals = len(world), len(world.goals)
    if stop is None:
        return lambda wanted, ahead: ahead % states == world.goals[wanted % goals]
    if isinstance(stop, Tensor):
        return lambda wanted, ahead: stop[world.pair(wanted % goals, ahead % states)]
    return stop


def bar_interval() -> float:
    """Seconds between two drawings of a progress bar: in a file each drawing is a line."""
    return 0.2 if sys.stderr.isatty() else 10.0
