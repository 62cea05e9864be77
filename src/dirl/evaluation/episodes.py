"""Episodes of a policy in a world: from given starts, until it stops, without rewards."""

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Protocol

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from tqdm import tqdm

from dirl.agent.agent import MANY, Memory, make_agent
from dirl.agent.decisions import AgentBatch, WorldTables, deciding, locating
from dirl.agent.mapping.places import PlaceMap
from dirl.envs import SurroundingViews
from dirl.models import caching
from dirl.perception.recognition.recogniser import NCC, StopRule, VisitScores
from dirl.scenes import ACTIONS
from dirl.scenes.world import World

BAR_SECONDS = 0.2 if sys.stderr.isatty() else 10.0
"""Between two drawings of a progress bar: in a file each drawing is a line."""


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

    @classmethod
    def failed(cls, goal_index: Tensor, start: Tensor, shortest: Tensor, max_steps: int) -> "Episodes":
        """Return episodes that have not arrived anywhere, to be filled in."""
        never = (torch.zeros_like(start, dtype=torch.bool) for _ in range(3))
        return cls(goal_index, start, shortest, torch.full_like(start, max_steps), *never)

    def select(self, chosen: Tensor) -> "Episodes":
        """Return some of the episodes, by mask or index."""
        return Episodes(*(value[chosen] for value in vars(self).values()))


class RandomPolicy(TensorDictModuleBase):
    """Each action with the same probability, whatever is observed: writes ``logits``, float32 ``[B, 4]``.

    Where places lie it tells as the policy ``like`` does, if there is one; see `dirl.agent.decisions.locating`.
    """

    in_keys: ClassVar = ["state"]
    out_keys: ClassVar = ["logits"]

    def __init__(self, like: nn.Module | None = None) -> None:
        super().__init__()
        self.locator, self.features = getattr(like, "locator", None), getattr(like, "features", None)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``logits``."""
        state = tensordict["state"]
        return tensordict.set("logits", torch.zeros((*state.shape, len(ACTIONS)), device=state.device))


def every_start(world: World) -> tuple[Tensor, Tensor]:
    """Return each goal with each other state that reaches it: goal index and start, int64 ``[E]`` each."""
    goal_index, start = world.pairs()
    reaches = world.distances > 0
    return goal_index[reaches], start[reaches]


def sampled_starts(world: World, per_goal: int, seed: int) -> tuple[Tensor, Tensor]:
    """Sample ``per_goal`` starts for each goal, uniformly with replacement, as in the paper's section 4.5.2."""
    generator = torch.Generator().manual_seed(seed)
    drawn = []
    for index, offset in enumerate(world.offsets):
        reaches = torch.stack([world.block(world.distances, goal) > 0 for goal in world.goals_of[index]])
        starts = torch.multinomial(reaches.float().cpu(), per_goal, replacement=True, generator=generator)
        drawn.append(starts.flatten() + offset)
    goal_index = torch.arange(len(world.goals)).repeat_interleave(per_goal)
    return goal_index.to(world.device), torch.cat(drawn).to(world.device)


def shortest_episodes(world: World, starts: tuple[Tensor, Tensor]) -> Episodes:
    """Return the expert's episodes from given starts, from the distances alone: the expert never fails."""
    goal_index, start = starts
    shortest = world.distance(goal_index, start)
    never = torch.zeros_like(start, dtype=torch.bool)
    return Episodes(goal_index, start, shortest, shortest, ~never, never, never)


class Metric(Protocol):
    """Measures of one's own: a class that a YAML file names, made with its options."""

    def __call__(self, episodes: Episodes) -> Mapping[str, float]:
        """Return the measures of some episodes by name."""


@dataclass(frozen=True)
class EvaluationProtocol:
    """The conditions under which policies are evaluated."""

    world: World
    observation: SurroundingViews
    """What the policies observe."""
    starts: tuple[Tensor, Tensor]
    """Goal index and start state of each episode, int64 ``[E]`` each; see `dirl.evaluation.episodes.every_start`."""
    stop: Tensor | StopRule | None = None
    """Where an agent stops on its way to each goal, bool ``[P]``, see `World.pair`, or by what it sees; None = exactly
    at the goal. With a `LocalisingMemory` its log odds, `dirl.perception.recognition.recogniser.ScoreFunction`."""
    max_steps: int = 200
    """An episode that has not arrived by then has failed."""
    seed: int = 0
    """Of sampled actions."""
    memory: Memory | None = None
    """Changes the policies' logits by what was done in the episode, see `dirl.models.PlanningMemory`."""
    scores: VisitScores | None = None
    """By which the memory knows places; None = correlation."""
    maps: Sequence[PlaceMap] | None = None
    """Of a walk through each scene, with which a `LocalisingMemory` begins; None = it knows nothing."""
    looks: range | None = None
    """Of visits and goals in a world that changes; None = all."""
    photos: range | None = None
    """Of goals, if they are others."""
    shown: Tensor | None = None
    """The goal of the same scene that is shown in the place of each, int64 ``[G]``, for controls; None = itself."""
    panorama: bool = False
    """Agents with a memory of places see all headings of theirs, as in a panorama, not only four."""
    arrows: bool = False
    """Agents see which moves are possible where they are, as visitors of a tour do."""
    metric: "Metric | None" = None
    """Measures of one's own, beside those of the paper."""
    live: Callable[..., Episodes] | None = None
    """``live(policy, told=False)``: episodes in the simulator that it was trained in, if any; see `evaluate_live`."""
    walked: tuple[Episodes, ...] = ()
    """Its greedy, sampled and random episodes, where they were walked before, together with those of other runs."""
    held_out: "EvaluationProtocol | None" = None
    """The same for goals that were held out of the training, if there are any."""

    @torch.no_grad()
    def run(
        self, policy: nn.Module, *, greedy: bool = True, passed: list[tuple[Tensor, Tensor, Tensor]] | None = None
    ) -> Episodes:
        """Walk one episode from each start. In a world that changes every visit and every goal has a look sampled.

        The look of its goal is not sampled for the visits of an episode: no place looks to the bit as in the goal's
        views.

        This is no TorchRL rollout, for two reasons. Finished episodes leave the batch, which an ``EnvBase`` does not
        support. And a memoryless policy is evaluated once for all agents with the same observation and goal.

        Args:
            policy: reads a tensordict and writes ``logits``; with memory also its next recurrent state.
            greedy: take the most probable action (of equal ones the first), else draw one.
            passed: where after each step the unfinished episodes, their states and actions are added, int64 ``[W]``
                each.
        """
        if self.walked:
            return self.walked[0 if greedy else 1]
        world, observation, memory, scores = self.world, self.observation, self.memory, self.scores
        goal_index, start = self.starts
        episodes = Episodes.failed(goal_index, start, world.distance(goal_index, start), self.max_steps)
        generator = torch.Generator(world.device).manual_seed(self.seed)
        states, goals = len(world), len(world.goals)
        stop = world.distances == 0 if self.stop is None else self.stop
        wanted = drawn_looks(goal_index, goals, world, generator, looks=self.photos or self.looks)
        # In a control the policy is shown other goals, in the same look.
        shown = wanted if self.shown is None else self.shown[wanted % goals] + wanted // goals * goals
        few = len(start) <= MANY
        if memory is not None and scores is None:
            scores = VisitScores(NCC(), world)
        with (
            caching(policy, learns=False),
            tqdm(
                total=len(start), unit=" episodes", unit_scale=True, leave=False, mininterval=BAR_SECONDS, disable=few
            ) as bar,
        ):
            at_random = isinstance(policy, RandomPolicy) and not (greedy or few or memory)
            known = WorldTables(
                world,
                observation,
                decide=None if at_random else deciding(policy, world, observation, len(start)),
                arrived=stop
                if callable(stop)
                else lambda wanted, ahead: stop[world.pair(wanted % goals, ahead % states)],
                scores=scores,
                locate=locating(policy, world),
                around=world.panoramas() if self.panorama else None,
                possible=world.possible if self.arrows else None,
                sweeps=isinstance(policy, RandomPolicy),
            )

            every = torch.arange(len(start), device=world.device)
            # A memory of many episodes takes much space until they have ended.
            together = list(every.split(MANY if memory is not None else max(1, len(start))))
            if self.maps is not None:
                scene_of_start = world.scene_of[start]
                together = [every[scene_of_start == scene] for scene in scene_of_start.unique()]
            for rows in together:
                besides = None if self.photos else wanted[rows] // goals
                ahead = drawn_looks(start[rows], states, world, generator, besides, self.looks)
                view_ids = observation.reset_view_ids(ahead)
                walk = AgentBatch(known, rows, wanted[rows], shown[rows], start[rows], ahead, view_ids)
                scene = world.scene_of[walk.state]
                agent = make_agent(memory, world.turns[scene], None if self.maps is None else self.maps[int(scene[0])])
                agent.arrive(walk)  # no agent stops before its first step
                for step in range(1, self.max_steps + 1):
                    if at_random:
                        action = torch.randint(len(ACTIONS), walk.state.shape, generator=generator, device=world.device)
                    else:
                        action, _ = agent.act(walk, generator, greedy=greedy)
                    state = world.graph[walk.state, action]
                    besides = None if self.photos else walk.wanted // goals
                    ahead = drawn_looks(state, states, world, generator, besides, self.looks)
                    walk = replace(
                        walk, state=state, ahead=ahead, view_ids=observation.step_view_ids(walk.view_ids, ahead)
                    )
                    stopped = agent.arrive(walk)
                    at_goal = state == world.goals[goal_index[walk.episode]]
                    episodes.success[walk.episode] = stopped & at_goal
                    episodes.false_stop[walk.episode] = stopped & ~at_goal
                    episodes.missed_stop[walk.episode] |= at_goal & ~stopped
                    episodes.steps[walk.episode[stopped & at_goal]] = step
                    if passed is not None:
                        passed.append((walk.episode, state, action))
                    going = torch.nonzero(~stopped).flatten()
                    bar.update(len(stopped) - len(going))
                    if not len(going):
                        break
                    agent.select(going)
                    walk = walk.select(going)
        return episodes

    def run_random(self) -> Episodes:
        """Return the same for random actions. The environment stops the agent, so that it makes no false stops."""
        if self.walked:
            return self.walked[2]
        return replace(self, stop=None, memory=None, maps=None, panorama=False).run(RandomPolicy(), greedy=False)

    def trajectories(
        self, policy: nn.Module, starts: tuple[Tensor, Tensor], *, greedy: bool = True
    ) -> tuple[Episodes, list[list[int]]]:
        """Return episodes from given starts, and the states that each passed, from its start to its last state."""
        passed: list[tuple[Tensor, Tensor, Tensor]] = []
        episodes = replace(self, starts=starts, walked=()).run(policy, greedy=greedy, passed=passed)
        paths = [[state] for state in starts[1].tolist()]
        for walking, states, _ in passed:
            for episode, state in zip(walking.tolist(), states.tolist(), strict=True):
                paths[episode].append(state)
        return episodes, paths

    def walks(self, policy: nn.Module, starts: tuple[Tensor, Tensor]) -> list[Tensor]:
        """Return actions of greedy episodes from given starts, until each stops or fails; int64 ``[steps]`` each."""
        passed: list[tuple[Tensor, Tensor, Tensor]] = []
        replace(self, starts=starts, walked=()).run(policy, passed=passed)
        episode, _, action = (torch.cat(parts) for parts in zip(*passed, strict=True))
        order = torch.argsort(episode, stable=True)
        return list(action[order].split(torch.bincount(episode, minlength=len(starts[0])).tolist()))


def drawn_looks(
    index: Tensor,
    count: int,
    world: World,
    generator: torch.Generator | None = None,
    besides: Tensor | None = None,
    looks: range | None = None,
) -> Tensor:
    """Sample a look for each state or goal, int64 ``[B]`` below ``count``; return ``look * count + index``.

    It is one of ``looks``, or of all that the world has, but not that of ``besides``, int64 ``[B]``: those of the
    goals, which shall not return to the bit.
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
