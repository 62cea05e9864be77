"""The decisions of a policy in the states of a world, with as few forward passes as possible."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import torch
from tensordict import TensorDict
from torch import Tensor, nn

from dirl.agent.agent import NEVER
from dirl.envs import SurroundingViews
from dirl.envs.transforms import VIEWS
from dirl.models import caching, initial_state, recurrent_keys
from dirl.models.belief import here_odds
from dirl.models.distinct import EmbeddingCache, Keys, packable
from dirl.perception.backbones.patches import are_fine
from dirl.perception.recognition.recogniser import StopRule, VisitScores
from dirl.scenes import ACTIONS
from dirl.scenes.world import World

PAIRS_AT_ONCE = 16_384

STATES_PASSED = 50
"""By an episode, roughly; with more pairs of goal and state than all episodes pass, the policy is called on the way."""

Decide = Callable[[Tensor, Tensor, Tensor, Tensor], Tensor]
"""From B agents' episode, view ahead, view ids ``[B, V]`` and goal, int64, to logits ``[B, 4]``.

The view ahead is a view id, ``look * N + state``. A goal is its place among the world's G goals, plus G times its
look.
"""


def deciding(policy: nn.Module, world: World, observation: SurroundingViews, episodes: int) -> Decide:
    """Return a function from the agents' states to their logits, with as few forward passes as possible.

    A memoryless policy on surrounding views has one output for each pair of goal and state; all are computed
    beforehand, unless episodes are few. With sequential views each distinct input is computed once, when it first
    occurs. A policy with memory is called at every step.
    """
    if hasattr(policy, "decide"):  # the policies of a stack, each of which is asked in its own episodes
        decide: Decide = policy.decide  # type: ignore[assignment]
        return decide
    if recurrent_keys(policy):
        return _with_memory(policy, world, observation, episodes)
    if observation.history and packable(observation.pictures + 1, len(observation.order)):
        return _once_a_case(policy, world, observation)
    if world.looks > 1 or observation.history or max(PAIRS_AT_ONCE, STATES_PASSED * episodes) < len(world.distances):
        return lambda _, ahead, view_ids, wanted: policy(observe(world, observation, ahead, view_ids, wanted))["logits"]
    table, _ = answers(policy, world, observation)
    return lambda episode, ahead, view_ids, wanted: table.index_select(0, world.pair(wanted, ahead))


def locating(policy: nn.Module, world: World) -> Callable[[Tensor, Tensor], Tensor] | None:
    """Return a function from view ids, ``[P, 4]``, to where goals lie; None if the policy has none.

    View ids are of visits and of goals, see `dirl.models.locator.GoalLocator`.
    """
    locator = getattr(policy, "locator", None)
    if locator is None:
        return None
    locator.eval()  # it has dropout, and evaluations leave policies as they were trained
    features: Any = policy.features
    fine = fine_patches(world)

    def located(seen: Tensor, goal: Tensor) -> Tensor:
        patches = [] if fine is None else [fine[seen], fine[goal[:, goal[0] < len(fine)]]]
        told: Tensor = locator(features(seen), features(goal), *patches)
        return told

    def locate(seen: Tensor, goal: Tensor) -> Tensor:
        pairs = zip(seen.split(PAIRS_AT_ONCE), goal.split(PAIRS_AT_ONCE), strict=True)
        return torch.cat([located(*some) for some in pairs])

    return locate


def fine_patches(world: World) -> Tensor | None:
    """Return the patches of a world's views, float16 ``[M, 48, 96]``; None if they are coarse, or missing."""
    return world.patches if world.patches is not None and are_fine(world.patches) else None


def _once_a_case(policy: nn.Module, world: World, observation: SurroundingViews) -> Decide:
    keys, goals = Keys(observation.pictures + 1, len(observation.order)), len(world.goals) * world.looks
    seen = EmbeddingCache(keys.unpack)

    def answer(cases: Tensor) -> Tensor:
        goal, views = cases % goals, seen.rows[cases // goals]
        logits: Tensor = policy(observe(world, observation, views[:, -1], views, goal))["logits"]
        return logits

    answered = EmbeddingCache(answer)

    def decide(episode: Tensor, ahead: Tensor, view_ids: Tensor, wanted: Tensor) -> Tensor:
        place = answered.places(seen.places(keys.pack(view_ids)) * goals + wanted)
        return answered.rows[place]

    return decide


def _with_memory(policy: nn.Module, world: World, observation: SurroundingViews, episodes: int) -> Decide:
    memory = initial_state(policy, episodes, world.device)
    begins = torch.ones((episodes, 1), dtype=torch.bool, device=world.device)

    def decide(episode: Tensor, ahead: Tensor, view_ids: Tensor, wanted: Tensor) -> Tensor:
        asked = observe(world, observation, ahead, view_ids, wanted)
        asked.update({"is_init": begins[episode], **{key: value[episode] for key, value in memory.items()}})
        logits: Tensor = policy(asked)["logits"]
        for key, value in memory.items():
            value[episode] = asked["next", key]
        begins[episode] = False
        return logits

    return decide


def observe(world: World, observation: SurroundingViews, ahead: Tensor, view_ids: Tensor, wanted: Tensor) -> TensorDict:
    """Return a policy's input, ``[B]``: state, goal, scene, and the view ids of state and goal; see `Decide`."""
    goal, look = world.goals[wanted % len(world.goals)], wanted // len(world.goals)
    return TensorDict(
        {
            "state": ahead % len(world),
            "goal": goal,
            "scene": world.scene_of[goal],
            "view_ids": view_ids,
            "goal_view_ids": observation.goal_view_ids(goal + look * len(world)),
        },
        batch_size=[len(ahead)],
    )


@torch.no_grad()
def answers(
    policy: nn.Module, world: World, observation: SurroundingViews, goal_index: int | None = None
) -> tuple[Tensor, Tensor]:
    """Return the outputs of a policy for every pair of a goal and a state of its scene.

    Sequential views and memories are those at the start of an episode; states and goals have their default look.
    `deciding` looks up those of all goals.

    Returns:
        Logits, float32 ``[P, 4]``, and state values, ``[P]``, zero if the policy has none. With a ``goal_index``, the
        place of one goal in ``world.goals``, only those of the states of its scene.
    """
    goals, states = world.pairs()
    if goal_index is not None:
        goals, states = world.block(goals, goal_index), world.block(states, goal_index)
    logits = torch.zeros((len(goals), len(ACTIONS)), device=world.device)
    values = torch.zeros(len(goals), device=world.device)
    with caching(policy, learns=False):
        for first in range(0, len(goals), PAIRS_AT_ONCE):
            place = slice(first, first + PAIRS_AT_ONCE)
            state = states[place]
            asked: Any = observe(world, observation, state, observation.reset_view_ids(state), goals[place])
            asked["is_init"] = torch.ones((len(state), 1), dtype=torch.bool, device=world.device)
            asked.update(initial_state(policy, len(state), world.device))
            answered = policy(asked)
            logits[place] = answered["logits"]
            if "state_value" in answered:
                values[place] = answered["state_value"].squeeze(-1)
    return logits, values


@dataclass(frozen=True, eq=False)
class WorldTables:
    """What is looked up of a world: the answers of policy and recogniser."""

    world: World
    observation: SurroundingViews
    decide: Decide | None
    """None for agents that are not asked."""
    arrived: StopRule
    """True where agents stop; with a `LocalisingMemory` the log odds, a `ScoreFunction`."""
    scores: VisitScores | None = None
    """By which a memory recognises places."""
    locate: Callable[[Tensor, Tensor], Tensor] | None = None
    """Where goals lie, see `locating`."""
    around: Tensor | None = None
    """The states that are seen from each, clockwise, int64 ``[N, K]``; None = `World.surrounding`."""
    possible: Tensor | None = None
    """Which moves are possible in each state, where agents see arrows, bool ``[N, 4]``."""
    sweeps: bool = False
    """Whether the agents ignore their goals, as a control."""


@dataclass(frozen=True, eq=False)
class AgentBatch:
    """Agents on their way through a world, the `dirl.agent.agent.Observed` that is looked up; all int64 ``[W]``."""

    known: WorldTables
    episode: Tensor
    wanted: Tensor
    """Their goals, see `Decide`."""
    shown: Tensor
    """The goals that the policy is shown: others in a control."""
    state: Tensor
    """Where they are."""
    ahead: Tensor
    """What they see ahead there, by view id."""
    view_ids: Tensor
    """What the policy observes, ``[W, 4]``."""

    points: ClassVar[None] = None
    """A world holds no points of its views."""

    def select(self, chosen: Tensor) -> "AgentBatch":
        """Return some of the agents, by index."""
        rows = (self.episode, self.wanted, self.shown, self.state, self.ahead, self.view_ids)
        return AgentBatch(self.known, *(row.index_select(0, chosen) for row in rows))

    @cached_property
    def visit(self) -> Tensor:
        """The view ids around the agents, int64 ``[W, K]``."""
        around = self.known.world.surrounding if self.known.around is None else self.known.around
        state = self.ahead % len(self.known.world)
        return around[state] + (self.ahead - state).unsqueeze(-1)

    @property
    def arrows(self) -> Tensor | None:
        """See `dirl.agent.agent.Observed`, as all below."""
        possible = self.known.possible
        return None if possible is None else possible[self.visit % len(possible)]

    @property
    def pooled(self) -> Tensor:
        """Pooled features of the views around the agents."""
        return self.known.world.features[self.visit]

    @property
    def along(self) -> Tensor | None:
        """Features of what is seen along the arrow of each view around the agents."""
        world = self.known.world
        return None if world.along is None else world.along[self.visit % len(world)]

    @property
    def toward(self) -> Tensor | None:
        """How clearly the arrows around the agents lead to the goals that are shown."""
        world = self.known.world
        if world.toward is None or self.known.sweeps:
            return None
        pairs = world.pair(self.shown[:, None] % len(world.goals), self.visit % len(world))
        return world.toward[int(self.photo), pairs]

    @property
    def goal_pooled(self) -> Tensor:
        """Pooled features of the goals that are shown."""
        world = self.known.world
        return world.features[self.visit[:, :0] if self.known.sweeps else self._known_views(self.shown)]

    def alike(self, seen: Tensor) -> Tensor:
        """Compare the visit with earlier ones."""
        assert self.known.scores is not None
        return self.known.scores.of_visits(seen, self.visit)

    def logits(self) -> Tensor:
        """Return the policy's logits; where agents see arrows, those of blocked moves are `NEVER`."""
        assert self.known.decide is not None
        logits = self.known.decide(self.episode, self.ahead, self.view_ids, self.shown)
        possible = self.known.possible
        return logits if possible is None else logits.masked_fill(~possible[self.ahead % len(possible)], NEVER)

    def facing(self, chosen: Tensor) -> Tensor:
        """Return the chosen agents' logits, facing each view; zero for others."""
        assert self.known.decide is not None
        ahead = self.visit[chosen].flatten()
        logits = torch.zeros((*self.visit.shape, len(ACTIONS)), device=ahead.device)
        if len(ahead):
            views = self.visit.shape[1]
            episode, shown = (rows[chosen].repeat_interleave(views) for rows in (self.episode, self.shown))
            asked = self.known.decide(episode, ahead, self.known.observation.reset_view_ids(ahead), shown)
            logits[chosen] = asked.view(-1, views, len(ACTIONS))
        return logits

    @property
    def inputs(self) -> Tensor:
        """The view ids around the agents."""
        return self.visit

    def displacement(self, earlier: Tensor | None = None) -> Tensor | None:
        """Return where the goals that are shown lie, or the places of earlier visits, facing each view."""
        if earlier is None and self.known.sweeps:
            return None
        if earlier is None and torch.equal(self.shown, self.wanted):
            return self._located
        return self._locate(self._goal_view_ids(self.shown) if earlier is None else earlier)

    def place_odds(self) -> Tensor | None:
        """Return the log odds that the agents are at their goals' places; only fine patches tell them well."""
        if fine_patches(self.known.world) is None or self._located is None:
            return None
        return here_odds(self._located)

    @cached_property
    def _located(self) -> Tensor | None:
        """Where the goals lie, which may be others than those that are shown."""
        return self._locate(self._goal_view_ids(self.wanted))

    def _locate(self, view_ids: Tensor) -> Tensor | None:
        if self.known.locate is None or self.visit.shape[1] > VIEWS:
            return None
        return self.known.locate(self.visit, view_ids)

    def at_goal(self) -> Tensor:
        """Return True where agents stop."""
        return self.known.arrived(self.wanted, self.ahead)

    def goal_around(self, chosen: Tensor) -> Tensor:
        """Return True where chosen agents would stop at the goal they are shown, facing each view; False for others."""
        stops = torch.zeros_like(self.visit, dtype=torch.bool)
        stops[chosen] = self.known.arrived(self.shown[chosen].unsqueeze(-1), self.visit[chosen])
        return stops

    @property
    def photo(self) -> bool:
        """Whether the goals are photos."""
        return self.known.observation.goal_view == "front"

    def confirmed(self, odds: Tensor) -> Tensor:
        """Return the log odds as they are: a world holds no points of its views."""
        return odds

    def goal_odds(self, visits: Tensor, place: Tensor) -> Tensor:
        """Return the log odds that visits see the goal facing each view."""
        scores = self.known.scores
        if visits.shape[2] > VIEWS and scores is not None and scores.whole is not None:
            goal = self._known_views(self.wanted)
            if goal.shape[1] == VIEWS:  # a photo is compared with four views at a time
                return scores.of_goal(goal, visits, place)
        return self.known.arrived(self.wanted[:, None, None], visits)

    def _goal_view_ids(self, wanted: Tensor) -> Tensor:
        """Return the view ids of the goals, see `Decide`, int64 ``[W, 4]``; of a photo, three are of no view."""
        world = self.known.world
        look, goal = wanted // len(world.goals), world.goals[wanted % len(world.goals)]
        return self.known.observation.goal_view_ids(goal + look * len(world))

    def _known_views(self, wanted: Tensor) -> Tensor:
        """Return the view ids of the goals' known views, int64 ``[W, 4]``, or ``[W, 1]`` of a photo."""
        views = self._goal_view_ids(wanted)
        return views[:, views[0] < len(self.known.world.features)]
