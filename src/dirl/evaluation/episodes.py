"""Episodes of a policy in a world: from given starts, until it stops, without rewards."""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import torch
from torch import Tensor, nn
from tqdm import tqdm

from dirl.agent.decisions import Decide, deciding
from dirl.agent.mapping.places import PlaceMap
from dirl.agent.recall import Localising, Memory, Recall, WorldSight, recalling
from dirl.envs import SurroundingViews
from dirl.evaluation.experts import RandomPolicy
from dirl.models import LocalisingMemory, frozen
from dirl.recognition.matching import Arrived
from dirl.recognition.recogniser import NCC
from dirl.recognition.tables import VisitScores
from dirl.scenes import ACTIONS, World

MANY = 50_000
"""Agents for more than which actions are sampled by one random number each, where `torch.multinomial` draws four."""


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
        stop: where an agent stops, bool ``[P]``, see `World.pair`, or see `dirl.recognition.matching.Arrived`; at the
            goal itself if left out. With a `LocalisingMemory` its log odds, `dirl.recognition.matching.Compared`.
        max_steps: after so many steps an episode has failed.
        greedy: take the most probable action (of equal ones the first), else draw one.
        seed: of the draws.
        memory: changes logits by what was done in the episode, see `EpisodicMemory` and `PlanningMemory`.
        scores: by which the memory knows places; correlation if left out.
        maps: of a walk through each scene, which the episodes go on with; for a `LocalisingMemory`.
        looks: of visits and goals; all if left out.
        shown: the goal that the policy is shown instead of each goal, int64 ``[G]``; it must be in the same scene.
        watch: called after each step with the unfinished episodes, their states and actions, int64 ``[W]`` each.
    """
    goal_index, start = starts
    never = [torch.zeros_like(start, dtype=torch.bool) for _ in range(3)]
    episodes = Episodes(goal_index, start, world.distance(goal_index, start), torch.full_like(start, max_steps), *never)
    generator = torch.Generator(world.device).manual_seed(seed)
    wanted = drawn_looks(goal_index, len(world.goals), world, generator, looks=looks)
    arrived = _arrived(world, stop)
    few = len(start) <= MANY
    bar = tqdm(
        total=len(start), unit=" episodes", unit_scale=True, leave=False, mininterval=bar_interval(), disable=few
    )
    with frozen(policy), bar:
        at_random = isinstance(policy, RandomPolicy) and not (greedy or few or memory)
        decide = None if at_random else deciding(policy, world, observation, len(start))
        agents = _Agents(decide, arrived, world, observation, generator, greedy, shown, looks)
        if memory is not None and scores is None:
            scores = VisitScores(NCC(), world)
        for walking in _together(start, world, memory is not None, maps is not None):
            goal_look = wanted[walking] // len(world.goals)
            ahead = drawn_looks(start[walking], len(world), world, generator, goal_look, looks)
            walk = _Walk(walking, start[walking], ahead, observation.begin(ahead))
            if memory is not None and scores is not None:
                scene = world.scene_of[start[walking]]
                if maps is None:
                    agents.recall = recalling(memory, WorldSight(scores, len(walking)), world.turns[scene])
                else:
                    agents.recall = _going_on(memory, scores, maps[int(scene[0])], arrived, wanted[walking])
                agents.stop(walk, wanted[walking])  # no agent stops before its first step
            for step in range(1, max_steps + 1):
                going = _take_step(walk, agents, episodes, wanted, step)
                if watch is not None:
                    watch(walk.episode, walk.state, walk.action)
                left = int(going.sum())
                bar.update(len(going) - left)
                if not left:
                    break
                if agents.recall is not None:
                    agents.recall.select(going)
                walk = walk.going_on(observation, going)
    return episodes


def _together(start: Tensor, world: World, memory: bool, maps: bool) -> list[Tensor]:
    """The episodes that are walked at the same time, by their places in ``start``."""
    episodes = torch.arange(len(start), device=world.device)
    if maps:
        return [episodes[world.scene_of[start] == scene] for scene in world.scene_of[start].unique()]
    # A memory of many episodes takes much space until they have ended.
    return list(episodes.split(MANY if memory else max(1, len(start))))


def _going_on(memory: Memory, scores: VisitScores, known: PlaceMap, arrived: Arrived, wanted: Tensor) -> Localising:
    """The memory of agents that know a map, on their way to goals, int64 ``[B]``."""
    assert isinstance(memory, LocalisingMemory)
    sight = WorldSight(scores, len(wanted), known.seen)
    return Localising(memory, sight, known.begin(arrived(wanted[:, None, None], sight.seen)))


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


@dataclass
class _Walk:
    """Agents on their way."""

    episode: Tensor
    """int64 ``[W]``."""
    state: Tensor
    """Where they are, int64 ``[W]``."""
    ahead: Tensor
    """What they see ahead there, by view id, int64 ``[W]``."""
    view_ids: Tensor
    """What they saw before their last step, int64 ``[W, 4]``."""
    action: Tensor = field(default_factory=lambda: torch.empty(0))
    """Their last step, int64 ``[W]``."""

    def going_on(self, observation: SurroundingViews, going: Tensor) -> "_Walk":
        """Those that do not stop."""
        view_ids = observation.follow(self.view_ids, self.ahead)
        return _Walk(self.episode[going], self.state[going], self.ahead[going], view_ids[going])


@dataclass
class _Agents:
    """The agents of some episodes: what they do and where they stop."""

    decide: Decide | None
    """None for agents that do anything with the same probability."""
    arrived: Arrived
    world: World
    observation: SurroundingViews
    generator: torch.Generator
    greedy: bool
    shown: Tensor | None
    looks: range | None
    recall: Recall | None = None

    def act(self, walk: _Walk, wanted: Tensor) -> Tensor:
        """Their actions on the way to goals, see `Decide`; int64 ``[W]``."""
        if self.decide is None:
            return torch.randint(len(ACTIONS), wanted.shape, generator=self.generator, device=wanted.device)
        wanted = self._shown(wanted)
        policy = partial(self.decide, walk.episode, walk.ahead, walk.view_ids, wanted)
        if self.recall is None:
            return choose(policy(), self.generator, greedy=self.greedy)
        if isinstance(self.recall, Localising):
            logits = self.recall.plan()
        else:
            visit = self._visit(walk)
            logits = self.recall.adjust(visit, policy, partial(self._around, walk.episode, visit, wanted))
        action = choose(logits, self.generator, greedy=self.greedy)
        self.recall.acted(action)
        return action

    def stop(self, walk: _Walk, wanted: Tensor) -> Tensor:
        """Which agents stop where they are now, bool ``[W]``."""
        if not isinstance(self.recall, Localising):
            return self.arrived(wanted, walk.ahead)
        visit = self._visit(walk)
        odds = self.arrived(wanted.unsqueeze(-1), visit)
        return self.recall.arrive(visit, odds, partial(self._facing, walk.episode, visit, self._shown(wanted)))

    def _visit(self, walk: _Walk) -> Tensor:
        """The view ids around the agents, int64 ``[W, 4]``."""
        states = len(self.world)
        return self.world.surrounding[walk.ahead % states] + (walk.ahead - walk.ahead % states).unsqueeze(-1)

    def _shown(self, wanted: Tensor) -> Tensor:
        """The goals that the policy is shown: others in a control, in the same look."""
        if self.shown is None:
            return wanted
        goals = len(self.shown)
        return self.shown[wanted % goals] + wanted // goals * goals

    def _facing(self, episode: Tensor, visit: Tensor, wanted: Tensor, chosen: Tensor) -> Tensor:
        """The policy's logits of the chosen agents, bool ``[W]``, facing each view; float32 ``[W, 4, 4]``."""
        assert self.decide is not None
        facing, headings = visit[chosen].flatten(), visit.shape[1]
        there = [rows[chosen].repeat_interleave(headings) for rows in (episode, wanted)]
        logits = torch.zeros((*visit.shape, len(ACTIONS)), device=visit.device)
        if not len(facing):
            return logits
        asked = self.decide(there[0], facing, self.observation.begin(facing), there[1])
        logits[chosen] = asked.view(-1, headings, len(ACTIONS))
        return logits

    def _around(self, episode: Tensor, visit: Tensor, wanted: Tensor, chosen: Tensor) -> tuple[Tensor, Tensor]:
        """See `dirl.agent.recall.Around`; ``visit`` has the view ids around each agent, int64 ``[W, 4]``."""
        goal = torch.zeros_like(visit, dtype=torch.bool)
        goal[chosen] = self.arrived(wanted[chosen].unsqueeze(-1), visit[chosen])
        return self._facing(episode, visit, wanted, chosen), goal


def _take_step(walk: _Walk, agents: _Agents, episodes: Episodes, goals: Tensor, step: int) -> Tensor:
    """One step of all agents to ``goals``, int64 ``[E]``; which of them go on, bool ``[W]``."""
    wanted, world = goals[walk.episode], agents.world
    walk.action = agents.act(walk, wanted)
    walk.state = world.graph[walk.state, walk.action]
    goal_look = wanted // len(world.goals)
    walk.ahead = drawn_looks(walk.state, len(world), world, agents.generator, goal_look, agents.looks)
    at_goal = walk.state == world.goals[episodes.goal_index[walk.episode]]
    stopped = agents.stop(walk, wanted)
    episodes.success[walk.episode] = stopped & at_goal
    episodes.false_stop[walk.episode] = stopped & ~at_goal
    episodes.missed_stop[walk.episode] |= at_goal & ~stopped
    episodes.steps[walk.episode[stopped & at_goal]] = step
    return ~stopped


def bar_interval() -> float:
    """Seconds between two drawings of a progress bar: in a file each drawing is a line."""
    return 0.2 if sys.stderr.isatty() else 10.0


def choose(logits: Tensor, generator: torch.Generator, *, greedy: bool) -> Tensor:
    """The most probable action, or one sampled by its probability, of logits ``[B, 4]``; int64 ``[B]``."""
    if greedy:
        return logits.argmax(-1)
    probabilities = logits.softmax(-1)
    if len(logits) <= MANY:
        return torch.multinomial(probabilities, 1, generator=generator).squeeze(-1)
    drawn = torch.rand((len(logits), 1), generator=generator, device=logits.device)
    # The last bound is 1 up to rounding, and must not let a number beyond it.
    return (drawn >= probabilities.cumsum(-1)[:, :-1]).sum(-1)
