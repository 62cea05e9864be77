"""One agent for worlds and for images: what it observes becomes where it stops and what it does next.

A decision is written here once. An `Observed` says where the answers of policy and recogniser come from: agents in
worlds look them up (`dirl.agent.decisions.AgentBatch`), those with cameras compute them (`dirl.agent.cameras.Views`).
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

import torch
import torch.nn.functional as F
from torch import Tensor

from dirl.agent.mapping.graph_policy import GraphGuide
from dirl.agent.mapping.places import PlaceMap
from dirl.envs.transforms import VIEWS
from dirl.models import LocalisingMemory, PlanningMemory
from dirl.models.belief import UNLIKELY, GoalBelief
from dirl.models.localising import MOVE
from dirl.scenes import ACTIONS
from dirl.scenes.graph import AHEAD, BACK, LEFT, RIGHT

Memory = PlanningMemory | LocalisingMemory

NEVER = -20.0
"""Logit of a move that is not possible."""

TRUST = 0.5
"""Factor of the policy's logits where a memory plans: in places unlike its training rooms it is too sure of itself; in
rooms this makes hardly a difference. See docs/decisions.md."""

SAVED, CLEAR = 5.0, 5.0
"""Actions that a unit of `likeness` to the goal is worth along an arrow, and that one which clearly leads there is."""

LONGEST, UNUSUAL = 4, -4.0
"""Cells of the network that locates goals that a move may be long, and the log prior of more than one."""

CHANGED, MOST = 10.0, 5.0
"""Log odds that a panorama is of its place where nearly all has changed; and how much the odds of goals are lowered at
most. See `Localising.doubt`."""

MANY = 50_000
"""Above this number of agents, one random number samples an action, where `torch.multinomial` draws four."""


class Observed(Protocol):
    """What B agents see now, each beside its goal."""

    @property
    def visit(self) -> Tensor:
        """The views around the agents, clockwise from the one ahead, as memories keep them: view ids or descriptions.

        ``[B, K, ...]``: K is four, ahead, right, back and left; or in a panorama the number of turns in a full circle.
        """

    @property
    def arrows(self) -> Tensor | None:
        """Which moves are possible facing each view, as visitors of a tour see, bool ``[B, K, 4]``; None = unknown."""

    @property
    def pooled(self) -> Tensor:
        """Pooled features of the views around the agents, float32 ``[B, K, D]``."""

    @property
    def along(self) -> Tensor | None:
        """Pooled features of what is seen along the arrow of each view, ``[B, K, D]``; None = of the view itself."""

    @property
    def toward(self) -> Tensor | None:
        """How clearly the arrow of each view leads to the goal, 0 to 1, ``[B, K]``; None = unknown."""

    @property
    def goal_pooled(self) -> Tensor:
        """The goals' pooled features, float32 ``[B, V, D]``: V is four, one of a photo, zero if goals are ignored."""

    def alike(self, seen: Tensor) -> Tensor:
        """Compare the visit with earlier ones, ``[B, T, K, ...]``; return a score facing each view, ``[B, T, K]``."""

    def logits(self) -> Tensor:
        """Return the policy's logits, float32 ``[B, 4]``."""

    def facing(self, chosen: Tensor) -> Tensor:
        """Return the chosen agents' logits, bool ``[B]``, facing each view; ``[B, K, 4]``, zero for others."""

    @property
    def inputs(self) -> Tensor:
        """The views around the agents, by view id or features, ``[B, K, ...]``; `displacement` takes earlier ones."""

    def displacement(self, earlier: Tensor | None = None) -> Tensor | None:
        """Return where the goal lies, or the place of an earlier visit; None where nobody tells it.

        By the log probability of cells, facing each view, ``[B, K, S, S]``, see `dirl.models.locator.GoalLocator`.
        Nobody tells it in panoramas, which stand anywhere.
        """

    def place_odds(self) -> Tensor | None:
        """Return the log odds that the goal's place is here, whatever the heading, float32 ``[B]``; None = unknown."""

    def at_goal(self) -> Tensor:
        """Return True where the recogniser takes this visit for the goal, bool ``[B]``."""

    def goal_around(self, chosen: Tensor) -> Tensor:
        """Return `at_goal` for the chosen agents, facing each view, bool ``[B, K]``; False for others."""

    @property
    def photo(self) -> bool:
        """Whether a goal is one photo, not four views."""

    @property
    def points(self) -> Tensor | None:
        """Log odds by matched points that a photo was taken here, facing each view, ``[B, K]``; else None."""

    def confirmed(self, odds: Tensor) -> Tensor:
        """Return the log odds that the goal is seen, ``[B, K]``, corrected where points of its four views can tell."""

    def goal_odds(self, visits: Tensor, place: Tensor) -> Tensor:
        """Return the log odds that visits, ``[B, T, K, ...]``, see the goal facing each view; float32 ``[B, T, K]``.

        ``place`` holds all visits so far in the same form: they tell what the views of this place share.
        """


class Agent:
    """B agents in their episodes, without a memory; subclasses have one. A step is `arrive`, then `act`.

    A guide leads a single agent where it knows the way.
    """

    def __init__(self, guide: GraphGuide | None = None) -> None:
        self.guide = guide
        self.action = torch.empty(0)

    def arrive(self, now: Observed) -> Tensor:
        """Return True where agents stop now, bool ``[B]``."""
        return now.at_goal()

    def act(
        self, now: Observed, generator: torch.Generator | None = None, *, greedy: bool = True
    ) -> tuple[Tensor, Tensor]:
        """Return the actions of the agents that did not stop, int64 ``[B]``, and the logits behind them, ``[B, 4]``.

        An action is the most probable one, of equal ones the first, or sampled by its probability.
        """
        logits = self.logits(now)
        if greedy:
            self.action = logits.argmax(-1)
        elif len(logits) <= MANY:
            self.action = torch.multinomial(logits.softmax(-1), 1, generator=generator).squeeze(-1)
        else:
            drawn = torch.rand((len(logits), 1), generator=generator, device=logits.device)
            # The last bound is 1 up to rounding, and must not let a number beyond it.
            self.action = (drawn >= logits.softmax(-1).cumsum(-1)[:, :-1]).sum(-1)
        if self.guide is not None:
            led = self.guide.advise(four_of(now.visit)[0])
            self.guide.action = int(self.action) if led is None else led
            self.action = torch.full_like(self.action, self.guide.action)
        return self.action, logits

    def logits(self, now: Observed) -> Tensor:
        """Return the policy's logits, changed by what the agents remember."""
        return now.logits()

    def select(self, chosen: Tensor) -> None:
        """Keep some of the agents after a step, by mask or index."""


class Remembering(Agent):
    """Agents that compare what they see with all that they have seen in their episodes.

    A *node* is a visit and the heading of one of its K views: ``K * visit + heading``. What was ``seen`` in an earlier
    walk through the place, ``[1, T, K, ...]``, are visits as well.
    """

    def __init__(self, memory: Any, guide: GraphGuide | None = None) -> None:
        super().__init__(guide)
        self.memory = memory
        self.seen: Tensor | None = None
        self.past: Any = None
        """What the memory says of all visits: `PlanState` or `Places`; None before the first."""
        self.total: Tensor | None = None
        """Where agents see arrows, the sum of the pooled features of the places seen so far, float32 ``[B, D]``."""
        self.places: Tensor | None = None
        """How many places those are, float32 ``[B]``."""
        self.best: Tensor | None = None
        """How much this visit looks like the most similar earlier one, float32 ``[B]``; None at the first."""

    def remember(self, now: Observed) -> Tensor:
        """Add the visit; return how alike it and each earlier node are, float32 ``[B, T, K]``."""
        visit = now.visit[:, None]
        seen = visit[:, :0] if self.seen is None else self.seen.expand(len(visit), *self.seen.shape[1:])
        self.seen = torch.cat([seen, visit], 1)
        if not seen.shape[1]:
            return torch.zeros(seen.shape[:3], device=visit.device)
        alike = now.alike(seen)
        self.best = alike.flatten(1).amax(1)
        return alike

    def costs(self, now: Observed) -> Callable[[Tensor], Tensor]:
        """Return a function to call at new places: the cost of each action facing each view, float32 ``[B, K, 4]``.

        Costs are ``-log p`` of the policy, as far as it is trusted. Where arrows are seen, the next panorama lies
        metres away, and the policy is worse than a sweep that ignores the goal. There costs are numbers of actions, and
        the move along an arrow is the cheaper the more its view looks like the goal.
        """
        if now.arrows is None:
            return lambda chosen: -(TRUST * now.facing(chosen)).log_softmax(-1)
        return partial(self.arrow_costs, now)

    def arrow_costs(self, now: Observed, chosen: Tensor) -> Tensor:
        """Return `costs` where arrows are seen; the chosen agents, bool ``[B]``, are at new places."""
        assert now.arrows is not None
        if not chosen.any():  # most steps are turns, or lead to known places
            return torch.full_like(now.arrows, math.inf, dtype=torch.float32)
        views, goal = now.pooled, now.goal_pooled
        if self.total is None or self.places is None:
            self.total, self.places = torch.zeros_like(views[:, 0]), torch.zeros_like(views[:, 0, 0])
        self.total = self.total + chosen[:, None] * views.sum(1)
        self.places = self.places + chosen
        count = self.places * views.shape[1] + goal.shape[1]
        mean = (self.total + goal.sum(1)) / count[:, None]
        return arrow_costs(likeness(views, goal, mean, now.along), now.arrows, now.toward)

    def select(self, chosen: Tensor) -> None:
        """Keep some of the agents."""
        assert self.seen is not None
        self.action, self.seen, self.past = self.action[chosen], self.seen[chosen], self.past.select(chosen)
        if self.total is not None and self.places is not None:
            self.total, self.places = self.total[chosen], self.places[chosen]


class Planning(Remembering):
    """Agents with a `PlanningMemory`; ``turns`` in a full circle, int64 ``[B]``, or ``[1]`` if all have as many."""

    def __init__(self, memory: PlanningMemory, turns: Tensor, guide: GraphGuide | None = None) -> None:
        super().__init__(memory, guide)
        self.turns = turns

    def logits(self, now: Observed) -> Tensor:
        """Return the plan's logits; the policy is called only at new places, once for each view ahead."""
        alike = self.remember(now).flatten(1) > self.memory.threshold
        if self.past is None:
            self.past = self.memory.begin(self.turns.expand(len(alike)), now.visit.shape[1])
        else:
            self.past.action = self.action
        same = alike & self.past.used
        new = ~same.any(1)
        self.past = self.memory.arrive(self.past, same, self.costs(now)(new), now.goal_around(new))
        return self.memory.plan(self.past, steps=now.arrows is not None)


class Localising(Remembering):
    """Agents with a `LocalisingMemory`, which decides where they stop too; they may begin with a map of the place.

    All have the same number of turns in a full circle.
    """

    def __init__(
        self, memory: LocalisingMemory, turns: int, known: PlaceMap | None = None, guide: GraphGuide | None = None
    ) -> None:
        super().__init__(memory, guide)
        self.turns, self.known = turns, known
        self.shown = torch.empty(0)
        """Log odds that the goal is seen facing each view of this visit, by recogniser and points, ``[B, K]``."""
        self.belief: GoalBelief | None = None
        """Where the goals are; None where nobody tells, and with a map, which tells it."""
        self.before: Tensor | None = None
        """What was seen a step ago, see `Observed.inputs`."""
        self.again: Tensor | None = None
        """Mean log odds that a place is one with itself, a turn later, float32 ``[B]``; recent turns count more."""
        self.lengths: Tensor | None = None
        """Log probability, up to a constant, that a move is 1, 2, ... cells long, float32 ``[B, cells]``."""

    def arrive(self, now: Observed) -> Tensor:
        """Take in what the agents see; return True where they stop, bool ``[B]``."""
        agents, device = len(now.visit), now.visit.device
        if self.past is not None:
            self.past.action = self.action
        elif self.known is None:
            self.past = self.memory.begin(agents, device, self.turns, now.visit.shape[1])
        else:
            self.seen = self.known.seen.to(device)
            earlier = self.seen.expand(agents, *self.seen.shape[1:])
            self.past = self.known.begin(now.goal_odds(earlier, earlier))
        alike = self.remember(now)
        assert self.seen is not None
        odds = now.goal_odds(now.visit[:, None], self.seen)[:, 0] if now.points is None else now.points
        self.shown = odds = now.confirmed(odds)
        if now.visit.shape[1] > VIEWS and self.known is None:  # a panorama
            doubt = self.doubt(alike)
            alike = alike - doubt[:, None, None]
            if not now.photo:  # it may be of another day, so half as much, and not without a bound
                odds = odds - (doubt / 2).clamp(max=MOST)[:, None]
        alone = self.known is not None or self.memory.exact  # views that return bit for bit tell the place better
        if not alone and (place := now.place_odds()) is not None:
            # The recogniser tells the heading, and the network that locates the goal which place this is.
            shows = odds.isfinite()
            odds = torch.where(shows, odds.log_softmax(1) + place[:, None], -math.inf)
        self.past = self.memory.arrive(self.past, alike, odds, self.costs(now), now.arrows, self.stayed(now))
        displacement = now.displacement() if self.known is None else None
        if displacement is not None:
            position, heading = self.past.pose
            self.belief = self.belief or GoalBelief(agents, device)
            self.belief.see(displacement, position / MOVE, heading, self.turns, self.length)
        return self.memory.stops(self.past, self.belief)

    def doubt(self, alike: Tensor) -> Tensor:
        """Return how many nats to take off the log odds that panoramas are of one place, float32 ``[B]``.

        Who turns sees the same place again. The more alike it looks then, the more alike it has to look later.
        """
        if self.again is None:
            self.again = alike.new_full((len(alike),), CHANGED)
        if alike.shape[1]:
            turned = (self.action == RIGHT).long() - (self.action == LEFT).long()
            same = alike[torch.arange(len(alike), device=alike.device), -1, turned % alike.shape[2]]
            self.again = torch.where(turned != 0, (self.again + same) / 2, self.again)
        return ((self.again - CHANGED) / 2).clamp(min=0)

    def stayed(self, now: Observed) -> Tensor | None:
        """Return how much more likely this is seen if the last move was blocked, log ratios ``[B]``; None = unknown.

        Where the place of a step ago lies after a move also tells how long a move is, in cells of the network.
        """
        before, self.before = self.before, now.inputs
        if before is None or self.known is not None:
            return None
        # After a move ahead the earlier place lies behind; facing right it is to the right, and so on.
        lies = (self.action == BACK).long() - (self.action == AHEAD).long()
        if not lies.any():  # a turn is never blocked
            return torch.zeros(len(lies), device=lies.device)
        if (told := now.displacement(before)) is None:
            return None
        told, middle = told.clamp(min=UNLIKELY), told.shape[-1] // 2
        agent, view = (torch.arange(size, device=told.device) for size in told.shape[:2])
        cells = lies[:, None, None] * torch.arange(1 + min(LONGEST, middle), device=told.device)
        rows, columns = (middle + cells * lies.new_tensor(way)[:, None] for way in ((1, 0, -1, 0), (0, -1, 0, 1)))
        there = told[agent[:, None, None], view[:, None], rows, columns].mean(1)  # 0, 1, ... cells away
        if self.lengths is None:
            self.lengths = torch.full_like(there[:, 1:], UNUSUAL)
            self.lengths[:, 0] = 0.0
        blocked = self.memory.blocked
        seen = torch.logaddexp(there[:, :1] + math.log(blocked), there[:, 1:] + math.log(1 - blocked))
        self.lengths = self.lengths + torch.where(lies[:, None] != 0, seen, 0.0)
        return there[:, 0] - there[agent, self.length]

    @property
    def length(self) -> Tensor | None:
        """How many cells a move is long, most probably, int64 ``[B]``; None before the first."""
        return None if self.lengths is None else self.lengths.argmax(1) + 1

    def logits(self, now: Observed) -> Tensor:
        """Return the plan's logits."""
        return self.memory.plan(self.past, self.belief, steps=now.arrows is not None)

    def select(self, chosen: Tensor) -> None:
        """Keep some of the agents."""
        super().select(chosen)
        if self.before is not None:
            self.before = self.before[chosen]
        if self.again is not None:
            self.again = self.again[chosen]
        if self.lengths is not None:
            self.lengths = self.lengths[chosen]
        if self.belief is not None:
            self.belief.select(chosen)


def make_agent(
    memory: Memory | None, turns: Tensor, known: PlaceMap | None = None, guide: GraphGuide | None = None
) -> Agent:
    """Make agents at the start of their episodes; each memory's class above describes the arguments."""
    if isinstance(memory, LocalisingMemory):
        return Localising(memory, int(turns[0]), known, guide)
    if isinstance(memory, PlanningMemory):
        return Planning(memory, turns, guide)
    return Agent(guide)


def likeness(views: Tensor, goal: Tensor, mean: Tensor, along: Tensor | None = None) -> Tensor:
    """Return how much what lies in the direction of each view looks like the goal.

    Cosines of features that are not centred tell views of one place from those of another. Without the mean of the
    place they tell what differs within it. A view counts as the best of itself and the two beside it, because an arrow
    may lie aside of the heading that shows it; where what is seen along the arrow itself is known, half as much.

    Args:
        views: pooled features of the K views around the agents, clockwise, float32 ``[B, K, D]``.
        goal: of the goals' views, float32 ``[B, V, D]``.
        mean: of what was seen of the place, float32 ``[B, D]``.
        along: features of what is seen along the arrow of each view, float32 ``[B, K, D]``, or None.

    Returns:
        float32 ``[B, K]``, in [-1, 1]; zero without views of the goal.
    """
    if not goal.shape[1]:
        return views.new_zeros(views.shape[:2])
    centred, wanted = (F.normalize(features - mean.unsqueeze(1), dim=-1) for features in (views, goal))
    best = (centred @ wanted.mT).amax(-1)
    best = torch.stack([best, best.roll(1, 1), best.roll(-1, 1)]).amax(0)
    if along is None:
        return best
    exact = F.normalize(along - mean.unsqueeze(1), dim=-1) @ wanted.mT
    return (best + exact.amax(-1)) / 2


def arrow_costs(along: Tensor, arrows: Tensor, toward: Tensor | None = None) -> Tensor:
    """Return what agents that see arrows expect of trying each action facing each view, float32 ``[B, K, 4]``.

    What is not possible costs infinitely much: it is neither tried nor counted among what was not tried.

    Args:
        along: what is promised in the direction of each view, see `likeness`, float32 ``[B, K]``.
        arrows: which moves are possible facing each view, bool ``[B, K, 4]``.
        toward: how clearly each arrow leads to the goal, ``[B, K]``; where there is no doubt likeness counts no more.
    """
    cost = along.new_ones(*along.shape, len(ACTIONS))
    further = SAVED * (1 - along)
    if toward is not None:
        further = (further + CLEAR) * (1 - toward)
    cost[..., AHEAD] += further
    cost[..., BACK] += further.roll(-along.shape[1] // 2, 1)  # along the view behind
    return cost.masked_fill(~arrows, math.inf)


def four_of(views: Tensor) -> Tensor:
    """Return the views ahead, right, back and left, ``[B, 4, ...]``, of K views ``[B, K, ...]``."""
    return views[:, :: views.shape[1] // VIEWS]
