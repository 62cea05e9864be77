"""An episodic memory that localises: a Bayes filter over the places of the episode, and a stop that compares them."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Annotated, Self

import torch
from annotated_types import Interval
from torch import Tensor, nn

from dirl.envs.transforms import VIEWS
from dirl.models.belief import GoalBelief
from dirl.models.planning import SURE, Nodes, again_costs, cheapest, connect
from dirl.scenes import ACTIONS
from dirl.scenes.graph import AHEAD, LEFT, RIGHT

TURNED = (0, 1, -1, 0)
MOVED = (1, 0, 0, -1)
"""By ahead, right, left and back: turns to the right, and moves along the heading."""

MOVE = 100
"""A move along an axis, in the units of positions; moves end on a square grid, those at 45 degrees on its diagonals."""

FAR = 10_000 * MOVE
"""Between the start of an episode and where an earlier walk ended, as nothing is known of the way from there."""

UNLIKE = -7.0
"""The least log odds that the goal is seen: below, a calibration says nothing."""

OTHER_ARROWS = -7.0
"""Added to the log odds of places whose arrows are others: they do not change with light or furniture."""

TOWARDS = 1.5
"""Cost of a move not tried for each move that the goal is away from where it leads, in nats."""

TWICE = 0.4
"""Factor of the doubt that is left at a stop where a belief is added: what a visit says of its place is in both."""

LOOKS = 16
"""Visits of a panorama that looks like the goal after which no agent returns to see it again. Where views return, it
went to and fro; in rooms each look has other errors, and tells more."""

UNASKED = math.log(len(ACTIONS))
"""Cost of an action facing a heading that was not seen, for which the policy cannot be asked: all are as likely."""


@dataclass
class Places(Nodes):
    """What B agents have seen and done in T visits, of P places; made by `LocalisingMemory.begin`.

    A node is a place and one of the K headings there, ``K * place + heading``. A visit makes a place, which
    stays unused where the agent is at an earlier one. It sees V views: four, or in a panorama all K.
    """

    taken: Tensor
    """Whether an agent took an action at a node, so that ``after`` is no guess, bool ``[B, N, 4]``."""
    node: Tensor
    """Where each visit was, int64 ``[B, T]``."""
    goal: Tensor
    """Log odds of each visit that the goal is seen there, facing each of its views, float32 ``[B, T, V]``;
    minus infinity of a view that shows nothing."""
    position: Tensor
    """Of each place, to the right of and ahead of the start, in hundredths of a move, int64 ``[B, P, 2]``."""
    heading: Tensor
    """Of the first view of each place, in right turns since the start, int64 ``[B, P]``."""
    action: Tensor
    """The last action, int64 ``[B]``; -1 at the start, where agents may be anywhere."""
    mapped: Tensor
    """True if agents began with a map of an earlier walk, bool ``[B]``."""
    turns: int = VIEWS
    """Headings of a place, K: right turns in a full circle."""

    @property
    def here(self) -> Tensor:
        """The present node, int64 ``[B]``."""
        return self.node[:, -1]

    @property
    def seen(self) -> Tensor:
        """The nodes that each visit sees, int64 ``[B, T, V]``."""
        return self.around(self.node)

    @property
    def headings(self) -> Tensor:
        """Of each node of each place, in right turns since the start, int64 ``[B, P, K]``."""
        return (self.heading[..., None] + torch.arange(self.turns, device=self.heading.device)) % self.turns

    @property
    def pose(self) -> tuple[Tensor, Tensor]:
        """Where the agents are, in the units of `position`, and in right turns since the start, ``[B, 2]``, ``[B]``."""
        at, place = torch.arange(len(self.node), device=self.node.device), self.here // self.turns
        return self.position[at, place], (self.heading[at, place] + self.here) % self.turns

    def around(self, node: Tensor) -> Tensor:
        """Return the nodes that are seen from nodes ``[...]``, clockwise from the one ahead, ``[..., V]``."""
        views = self.goal.shape[-1]
        heading = node[..., None] + self.turns // views * torch.arange(views, device=node.device)
        return node[..., None] // self.turns * self.turns + heading % self.turns

    def select(self, chosen: Tensor) -> Self:
        """Return some of the agents, by mask or index."""
        return replace(self, **{name: value[chosen] for name, value in vars(self).items() if name != "turns"})

    def compact(self) -> "Places":
        """Return the places of one agent without unused ones."""
        kept = self.used[0].view(-1, self.turns).any(1).nonzero().flatten()
        row = torch.full((self.position.shape[1],), -1, device=kept.device)
        row[kept] = torch.arange(len(kept), device=kept.device)
        nodes = (self.turns * kept[:, None] + torch.arange(self.turns, device=kept.device)).flatten()

        def renumbered(node: Tensor) -> Tensor:
            return torch.where(node < 0, -1, self.turns * row[node // self.turns] + node % self.turns)

        return replace(
            self,
            cost=self.cost[:, nodes],
            after=renumbered(self.after[:, nodes]),
            taken=self.taken[:, nodes],
            node=renumbered(self.node),
            position=self.position[:, kept],
            heading=self.heading[:, kept],
        )


class LocalisingMemory(nn.Module):
    """Plans as `PlanningMemory` does, where no place looks the same twice.

    A single comparison of two visits is often wrong in such a place. So this memory is a Bayes filter. Its prior is the
    motion: an action whose outcome is known leads there again, another one leads one move on, or is blocked. Its
    evidence is the log odds of a calibrated recogniser, summed over the visits of a place. The most probable node is
    taken.

    The goal is searched in the same way. It may be at any node seen, with odds by the evidence of its visits, or at one
    not seen yet. The agent stops where the posterior probability exceeds ``confidence``. What looks like the goal but
    is not lies next to it, nearly always. So the moves that were not tried at the most probable place count as nodes
    where the goal may be, and the agent tries them first, unless the evidence is clear.

    Moves are assumed to be of one length, and turns of equal angles, up to ``slip``. Where turns are smaller than 90
    degrees, four views leave headings between them unseen, of which nothing is known until the agent faces one.

    Args:
        repeated: cost of a move whose outcome is known, in nats.
        turn: cost of a turn.
        blocked: prior probability that a move not tried yet is blocked.
        slip: prior probability that an action leads anywhere else than expected.
        confidence: stop above this probability that the goal is here. Fewer false stops cost longer paths.
        settle: the same where no move is left that was not tried, or a map of an earlier walk shows the place.
        elsewhere: how many nodes that look like the goal lie behind each move not tried, anywhere.
        neighbour: how many more lie behind each move not tried at the most probable place.
        seek: try all moves around a place above these log odds, and return to it to see it again.
        correlation: of the log odds of the visits of one place, as to the goal: the share that they have in common.
        least: tempered log odds of a single comparison below this count as this; a recogniser can be quite wrong.
        independence: how much further visits of a place add: the mean of n log odds counts n to this power.
        temperature: log odds as to where the agent is are divided by this (temperature scaling). They are calibrated
            for single comparisons, but comparisons with the places of one room err alike. With a map of an earlier walk
            they are not divided: agents may begin anywhere, and nothing but the evidence tells where.
    """

    def __init__(
        self,
        repeated: Annotated[float, Interval(ge=0, le=1000)] = 2.0,
        turn: Annotated[float, Interval(ge=0.001, le=1000)] = 0.1,
        blocked: Annotated[float, Interval(ge=0.001, le=0.999)] = 0.25,
        slip: Annotated[float, Interval(ge=1e-9, le=0.5)] = 0.02,
        confidence: Annotated[float, Interval(ge=0.01, le=0.9999)] = 0.95,
        settle: Annotated[float, Interval(ge=0.01, le=0.9999)] = 0.5,
        elsewhere: Annotated[float, Interval(ge=1e-6, le=1e6)] = 0.004,
        neighbour: Annotated[float, Interval(ge=0, le=1e6)] = 0.5,
        seek: float = 1.0,
        correlation: Annotated[float, Interval(ge=0, le=1)] = 0.5,
        least: float = -3.0,
        independence: Annotated[float, Interval(ge=0, le=1)] = 0.5,
        temperature: Annotated[float, Interval(ge=0.01, le=100)] = 2.5,
    ) -> None:
        super().__init__()
        self.repeated, self.turn, self.blocked, self.slip = repeated, turn, blocked, slip
        self.confidence, self.settle = confidence, settle
        self.elsewhere, self.neighbour = elsewhere, neighbour
        self.seek, self.correlation = seek, correlation
        self.least, self.independence, self.temperature = least, independence, temperature
        self.exact = False
        """Whether views return bit for bit, so that comparisons leave no doubt where the agent is."""

    def begin(self, agents: int, device: torch.device | str = "cpu", turns: int = VIEWS, views: int = VIEWS) -> Places:
        """Return what agents know at the start of their episodes: nothing.

        Args:
            agents: their number, B.
            device: of the tensors.
            turns: in a full circle, K.
            views: that are seen around an agent, V: four, or in a panorama as many as there are turns.
        """
        none = torch.empty((agents, 0), dtype=torch.int64, device=device)
        return Places(
            cost=torch.empty((agents, 0, len(ACTIONS)), device=device),
            after=none.new_empty(agents, 0, len(ACTIONS)),
            taken=torch.empty((agents, 0, len(ACTIONS)), dtype=torch.bool, device=device),
            node=none,
            goal=torch.empty((agents, 0, views), device=device),
            position=none.new_empty(agents, 0, 2),
            heading=none,
            action=torch.full((agents,), -1, device=device),
            mapped=torch.zeros(agents, dtype=torch.bool, device=device),
            turns=turns,
        )

    def arrive(
        self,
        places: Places,
        alike: Tensor,
        goal: Tensor,
        costs: Callable[[Tensor], Tensor],
        arrows: Tensor | None = None,
        stayed: Tensor | None = None,
    ) -> Places:
        """Add where the agents are now, and what their last action led to.

        Args:
            places: so far, T visits.
            alike: log odds that this visit is of the place of an earlier one, facing each of its views, float32
                ``[B, T, V]``.
            goal: log odds that the goal is seen here facing each of the views, float32 ``[B, V]``.
            costs: of the chosen agents, bool ``[B]``, the cost of trying each action facing each of the views, float32
                ``[B, V, 4]``; rows of others are not used.
            arrows: which moves are possible facing each of the views, as visitors of a tour see, bool ``[B, V, 4]``.
            stayed: how much more likely this visit was seen if the last move was blocked, log ratios, ``[B]``.
        """
        return self.add(places, self.likely(places, alike, arrows, stayed).argmax(1), goal, costs)

    def likely(
        self, places: Places, alike: Tensor, arrows: Tensor | None = None, stayed: Tensor | None = None
    ) -> Tensor:
        """Log probabilities, up to a constant, that the agents are now at each node or, last, at a new place.

        Agents that have not acted since the start may be at any place with the same probability. The result is float32
        ``[B, K P + 1]``; for the arguments see `arrive`.
        """
        evidence = self._evidence(alike, places)
        if arrows is not None and _panorama(places):
            nodes = torch.arange(evidence.shape[1], device=evidence.device)
            shown = places.cost.isfinite()[:, places.around(nodes)]  # [B, K P, V, 4]
            evidence = evidence + OTHER_ARROWS * (shown != arrows[:, None]).flatten(2).any(2)
        used, at = evidence > -math.inf, torch.arange(len(evidence), device=evidence.device)
        prior = (self.slip / used.sum(1, keepdim=True).clamp(min=1)).expand(used.shape)
        new = prior.new_full((len(used), 1), self.slip)
        if not _carried(places):
            position, heading = self._expected(places)
            outcome = places.after[at, places.here, places.action]
            there = places.headings == heading[:, None, None]
            panorama = _panorama(places)
            if not panorama:
                there = there & (places.position == position[:, None]).all(-1)[..., None]
            there = there.flatten(1) & used
            tried = outcome >= 0
            if panorama:  # they stand anywhere: an arrow is as likely to lead to a known place as to a new one
                arrow = places.cost[at, places.here, places.action].isfinite()
                there = there & arrow[:, None]
                known: float | Tensor = 0.5 / there.sum(1, keepdim=True).clamp(min=1)
                stays: float | Tensor = self.slip if arrows is None else torch.where(arrow, 0.0, 1 - self.slip)
                new[~tried & arrow] = 0.5
            else:
                stays = new.new_full((len(used),), self.blocked)
                if stayed is not None and not self.exact:
                    stays = (stays.logit() + stayed).sigmoid()
                known = 1 - stays[:, None]
                new = torch.where((tried | there.any(1))[:, None], new, known)
            prior = torch.where(there & ~tried[:, None], known, prior)
            prior[at, torch.where(tried, outcome, places.here)] = torch.where(tried, 1 - self.slip, stays)
        return torch.cat([prior.log() + evidence, new.log()], 1)

    def add(self, places: Places, here: Tensor, goal: Tensor, costs: Callable[[Tensor], Tensor]) -> Places:
        """Add a visit of agents that are at nodes ``here``, int64 ``[B]``; ``K P`` is a new place. See `arrive`."""
        position, heading = self._expected(places)
        turns, new = places.turns, places.cost.shape[1]
        is_new = here == new
        more = int(is_new.any())  # a place, unless all agents are at earlier ones
        cost = torch.where(is_new[:, None, None], UNASKED, math.inf).expand(-1, more * turns, len(ACTIONS))
        cost = torch.cat([places.cost, cost], 1)
        faced = places.around(here)
        first = is_new[:, None].expand(faced.shape)
        if faced.shape[1] < turns:  # views of a later visit may be between those of earlier ones
            first = (places.seen.flatten(1)[:, None] != faced[..., None]).all(-1)
        agent, view = first.nonzero(as_tuple=True)
        if len(agent):
            cost[agent, faced[agent, view]] = costs(first.any(1))[agent, view]
        headings = new + torch.arange(more * turns, device=here.device)
        after = torch.full((len(here), more * turns, len(ACTIONS)), -1, device=here.device)
        after[:, :, RIGHT], after[:, :, LEFT] = headings.roll(-1), headings.roll(1)
        arrived = Places(
            cost=cost,
            after=torch.cat([places.after, after], 1),
            taken=torch.cat([places.taken, torch.zeros_like(after, dtype=torch.bool)], 1),
            node=torch.cat([places.node, here[:, None]], 1),
            goal=torch.cat([places.goal, goal[:, None]], 1),
            position=torch.cat([places.position, position[:, None][:, :more]], 1),
            heading=torch.cat([places.heading, heading[:, None][:, :more]], 1),
            action=places.action,
            mapped=places.mapped,
            turns=turns,
        )
        if not _carried(places):
            possible = arrived.cost.isfinite()
            connect(arrived.after, places.here, places.action, here, turns, arrived.taken, possible)
        return arrived

    def stops(self, places: Places, belief: GoalBelief | None = None) -> Tensor:
        """Return True where agents stop now, bool ``[B]``; ``belief`` is where they believe their goals to be."""
        evidence = self._goal(places, belief)
        return self._certain(places, evidence, places.here, belief) & (evidence.argmax(1) == places.here)

    def plan(self, places: Places, belief: GoalBelief | None = None, *, steps: bool = False) -> Tensor:
        """Return the logits of the actions where the agents are, see `stops` and `PlanningMemory.plan`."""
        evidence = self._goal(places, belief)
        if belief is not None:
            places = replace(places, cost=places.cost + TOWARDS * _away(places, belief))
        turns = places.turns
        untried = (places.after < 0) & places.cost.isfinite()
        exits = untried.unflatten(1, (-1, turns)).flatten(2)  # at each place, [B, P, 4 K]
        odds, best = evidence.max(1)
        at = torch.arange(len(best), device=best.device)
        certain = self._certain(places, evidence, best, belief)
        around = (odds > self.seek) & ~certain & exits.any(-1)[at, best // turns]
        wanted = torch.zeros_like(exits)
        wanted[at, best // turns] = exits[at, best // turns] & around[:, None]
        wanted = wanted.view(places.after.shape)
        goal = torch.zeros_like(wanted[..., 0])
        unsure = odds > self.seek
        if _panorama(places):
            unsure = unsure & (_by_node(torch.ones_like(places.goal), places)[at, best] < LOOKS)
        goal[at, best] = (unsure | certain) & ~around & (best != places.here)
        known = places.after >= 0
        again = again_costs(places.cost, self.repeated, self.turn, steps=steps)
        # On the way to a goal that was seen, or around a place that is like it, an action more costs more than doubts.
        nearest = torch.where(known | wanted, SURE + torch.where(wanted, places.cost / SURE, 0.0), math.inf)
        seeking = (around | goal.any(1))[:, None, None]
        costs = cheapest(
            torch.where(seeking, nearest, torch.where(known, again, places.cost)), places.after, goal, places.here
        )
        return -torch.where(costs.isinf().all(-1, keepdim=True), places.cost[at, places.here], costs)

    def _certain(self, places: Places, evidence: Tensor, node: Tensor, belief: GoalBelief | None) -> Tensor:
        """Return True where the goal is at a node of the agent with the probability that is asked for, bool ``[B]``."""
        at = torch.arange(len(node), device=node.device)
        # A move back at one heading is the move ahead at the opposite one.
        untried = (places.after[..., AHEAD] < 0) & places.cost[..., AHEAD].isfinite()
        place = torch.arange(untried.shape[1], device=node.device) // places.turns
        near = (place == (node // places.turns)[:, None]) & ~places.mapped[:, None]
        # A map has doubles of places, whose moves were not tried from each of them.
        whole = places.mapped | ~untried.any(1)
        behind = (self.elsewhere + self.neighbour * near).log()
        if belief is not None:
            behind = behind + belief.odds(_ahead(places))
        behind = torch.where(untried, behind, -math.inf)
        anywhere = torch.full_like(behind[:, :1], math.log(self.elsewhere))
        every = torch.cat([evidence, behind, anywhere], 1).logsumexp(1)
        probability = (evidence[at, node] - every).exp()
        confidence = self.confidence if belief is None else 1 - TWICE * (1 - self.confidence)
        return probability > torch.where(whole, self.settle, confidence)

    def _expected(self, places: Places) -> tuple[Tensor, Tensor]:
        """Return position and heading by dead reckoning after the last action, int64 ``[B, 2]`` and ``[B]``."""
        action = places.action
        if _carried(places):
            return action.new_full((len(action), 2), FAR * places.node.shape[1]), torch.zeros_like(action)
        turned, moved = (torch.tensor(by, device=action.device)[action] for by in (TURNED, MOVED))
        position, heading = places.pose
        along = _steps(places.turns).to(action.device)[heading] * moved[:, None]
        # Of the first view of a place: the agent faces it when it arrives.
        return position + along, (heading + turned) % places.turns

    def _evidence(self, odds: Tensor, places: Places) -> Tensor:
        """Log odds of visits facing each view, float32 ``[B, T, V]``, as those of nodes, ``[B, K P]``."""
        temperature = torch.where(places.mapped | _panorama(places), 1.0, self.temperature)[:, None, None]
        tempered = odds if self.exact else (odds / temperature).clamp(min=self.least)
        total = _by_node(tempered, places)
        visits = _by_node(torch.ones_like(odds), places)
        evidence = total * visits.clamp(min=1) ** (self.independence - 1)
        # Of a heading that was not seen nothing is known, neither for nor against it.
        return torch.where(places.used, evidence, -math.inf)

    def _goal(self, places: Places, belief: GoalBelief | None = None) -> Tensor:
        """Log odds that the goal is at each node, float32 ``[B, K P]``."""
        told = places.goal.isfinite()
        total = _by_node(torch.where(told, places.goal.clamp(min=UNLIKE), 0.0), places)
        visits = _by_node(torch.ones_like(places.goal), places)
        # A visit that shows nothing makes less of what others told, or agents would return to see it again and again.
        known = _by_node(told.float(), places) > 0
        evidence = torch.where(known, total / (1 + (visits - 1) * self.correlation), -math.inf)
        if belief is None:
            return evidence
        return evidence + belief.odds(places.position / MOVE).repeat_interleave(places.turns, 1)


def _by_node(values: Tensor, places: Places) -> Tensor:
    """Sum what visits have for each of their views, float32 ``[B, T, V]``, by node, ``[B, K P]``."""
    none = values.new_zeros(len(values), places.cost.shape[1])
    return none.scatter_add(1, places.seen.flatten(1), values.flatten(1))


def _ahead(places: Places) -> Tensor:
    """Return where a move ahead would lead, in moves to the right and ahead of the start, float32 ``[B, K P, 2]``."""
    along = _steps(places.turns).to(places.heading.device)[places.headings]
    return (places.position[:, :, None] + along).flatten(1, 2) / MOVE


def _away(places: Places, belief: GoalBelief) -> Tensor:
    """Return how many moves the goal is believed to be from where moves not tried lead, float32 ``[B, N, 4]``."""
    ahead = belief.moves(_ahead(places))
    # A move back at one heading is the move ahead at the opposite one.
    back = ahead.unflatten(1, (-1, places.turns)).roll(places.turns // 2, 2).flatten(1)
    turned = torch.zeros_like(ahead)
    return torch.where(places.after < 0, torch.stack([ahead, turned, turned, back], 2), 0.0)


@cache
def _steps(turns: int) -> Tensor:
    """Return the displacement by a move ahead, facing as at the start, to the right of it, ..., int64 ``[K, 2]``."""
    angle = 2 * math.pi / turns * torch.arange(turns)
    way = torch.stack([angle.sin(), angle.cos()], 1)
    return (MOVE * way / way.abs().amax(1, keepdim=True)).round().long()


def _panorama(places: Places) -> bool:
    """Return True if agents see all headings of a place at once, as in a tour."""
    return places.goal.shape[2] > VIEWS


def _carried(places: Places) -> bool:
    """Return True if the agents have not acted yet in this episode; all begin at once."""
    return bool((places.action < 0).any())
