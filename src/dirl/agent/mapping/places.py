"""A map of places that never look the same twice, made by a walk with a particle filter over maps.

`ImageGraph` decides at every step which place this is, for good. Where a single observation is often wrong, one wrong
decision spoils the map. Here each of K particles is a whole map that samples its decision by the probabilities of a
`LocalisingMemory`, and particles whose maps explain what is seen later are copied over the others: a Rao-Blackwellised
particle filter, as in FastSLAM (Montemerlo et al. 2002), with a recogniser's log odds in place of a sensor model.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from dirl.envs.transforms import VIEWS
from dirl.models import LocalisingMemory
from dirl.models.localising import UNASKED, Places
from dirl.models.planning import again_costs, cheapest
from dirl.scenes.graph import ACTIONS, AHEAD, BACK

PARTICLES = 256
"""In validation rooms at 10 cm and 10 degrees 64 give 2.7 % wrong links, 256 give 1.6 %; at 5 cm 64 are enough."""

DOUBLE = 2.5
"""Mean log odds of all visits above which two places of a tour are one. In walks through two real tours those of one
place had 2.8 to 6.6 (one 0.7), those of two with the same arrows at most 1.8."""

BLOCKED = 0.1
"""Prior probability that a move of a walk is blocked: a walk tries all moves, an agent those that a policy likes."""


@dataclass(frozen=True)
class PlaceMap:
    """What one walk of T visits found out about a place with P places where the walker can stand."""

    places: Places
    """The places as one agent knows them."""
    seen: Tensor
    """The visits, by view ids or by described views, ``[1, T, V, ...]``."""

    def __len__(self) -> int:
        """Return the number of nodes, K P."""
        return self.places.cost.shape[1]

    @property
    def turns(self) -> int:
        """Right turns in a full circle, K."""
        return self.places.turns

    def begin(self, goal: Tensor) -> Places:
        """Return the state of agents that walked here once and begin an episode at a place that they do not know.

        ``goal``: the log odds that their goals are seen at each visit of the walk, facing each view, ``[B, T, V]``.
        """
        agents, device = len(goal), goal.device
        every = torch.zeros(agents, dtype=torch.int64, device=self.places.action.device)
        tensors = {name: value[every].to(device) for name, value in vars(self.places).items() if name != "turns"}
        nothing = torch.full((agents,), -1, device=device)
        tensors |= {"goal": goal, "action": nothing, "mapped": torch.ones_like(nothing, dtype=torch.bool)}
        return replace(self.places, **tensors)


class ParticleMapper:
    """A walk that makes a `PlaceMap`.

    Args:
        memory: whose slip, and weights of the evidence, are used.
        compare: how much earlier visits, ``[1, T, V, ...]``, look like a visit, ``[1, V, ...]``: log odds,
            ``[1, T, V]``.
        particles: maps at once, K.
        seed: of the draws.
        known: a map to walk on with, from any place.
        turns: in a full circle, K; if there is no such map.
        arrows: which moves are possible facing each view of a visit, as visitors of a tour see, ``[1, V, ...]`` to
            bool ``[1, V, 4]``; None = not told.
    """

    def __init__(
        self,
        memory: LocalisingMemory,
        compare: Callable[[Tensor, Tensor], Tensor],
        particles: int = PARTICLES,
        seed: int = 0,
        known: PlaceMap | None = None,
        turns: int = VIEWS,
        arrows: Callable[[Tensor], Tensor] | None = None,
    ) -> None:
        evidence = {name: getattr(memory, name) for name in ("slip", "least", "independence", "temperature")}
        # All actions cost the same, so that a walk goes to the nearest unknown outcome.
        self.memory = LocalisingMemory(repeated=1.0, turn=1.0, blocked=BLOCKED, **evidence)
        self.compare, self.seen = compare, None if known is None else known.seen
        self.turns, self.arrows = turns, arrows
        self.odds: list[Tensor] = []
        """In a tour, of each visit the log odds that it is at an earlier one, ``[T, V]``; see `without_doubles`."""
        self.places: Places | None = None
        if known is not None:
            self.turns, self.places = known.turns, known.begin(known.places.goal.expand(particles, -1, -1))
        self.weight = torch.zeros(particles)
        self.decided = torch.zeros(particles)
        """Log probability of all that each particle has sampled, up to a constant."""
        self.generator = torch.Generator().manual_seed(seed)

    @property
    def best(self) -> Places | None:
        """The most probable particle, as one agent; None before the first visit."""
        return None if self.places is None else self.places.select(self._leading()[None])

    @torch.no_grad()
    def see(self, visit: Tensor, action: int | None = None) -> int:
        """Take in what is seen around the walker and return the node where it most probably is.

        Args:
            visit: the views clockwise from the one ahead, four or those of all headings, ``[V, ...]``, in the form of
                the map.
            action: what the walker did since the visit before; None at first, or if it was carried.
        """
        particles, views = len(self.weight), len(visit)
        if self.places is None:
            self.places = self.memory.begin(particles, turns=self.turns, views=views)
        self.places.action = torch.full((particles,), -1 if action is None else action)
        visit = visit[None]
        seen = visit[:, None][:, :0] if self.seen is None else self.seen
        alike = self.compare(seen, visit) if seen.shape[1] else torch.zeros(1, 0, views)
        alike = alike.cpu().expand(particles, -1, -1)
        self.seen = torch.cat([seen, visit[:, None]], 1)
        arrows = None if self.arrows is None else self.arrows(visit).cpu().expand(particles, -1, -1)
        likely = self.memory.likely(self.places, alike, arrows)
        here = torch.multinomial(likely.softmax(1), 1, generator=self.generator).squeeze(1)
        cost = torch.full((particles, views, len(ACTIONS)), UNASKED)
        if arrows is not None:
            self.odds.append(alike[0])
            cost = cost.masked_fill(~arrows, math.inf)  # impossible moves: neither tried nor guessed
        self.places = self.memory.add(self.places, here, torch.zeros(particles, views), lambda _: cost)
        self.decided = self.decided + likely.gather(1, here[:, None]).squeeze(1)
        self.weight = self.weight + likely.logsumexp(1)
        probability = self.weight.softmax(0)
        if 1 / probability.square().sum() < particles / 2:
            kept = resampled(probability, self.generator)
            self.places, self.decided = self.places.select(kept), self.decided[kept]
            self.weight = torch.zeros(particles)
        return int(self.places.node[self._leading(), -1])

    def _leading(self) -> Tensor:
        """Return the particle whose map counts, int64 ``[]``.

        A weight does not tell what was sampled just now, however improbable. In a tour one such map in front is enough
        to lose the way, so there all decisions count together. In rooms at 10 cm maps are worse by that.
        """
        return (self.weight if self.arrows is None else self.decided).argmax()

    def frontier_action(self) -> int | None:
        """Return the first action of a shortest path to an unknown outcome; None without any, or before a visit.

        Where arrows are seen, passages of one way exist: once nothing is unknown, guesses are put to the test.
        """
        best = self.best
        if best is None:
            return None
        after, nowhere = best.after, torch.zeros_like(best.after[..., 0], dtype=torch.bool)
        tables = [after]
        if self.arrows is not None:
            moves = torch.tensor([action in (AHEAD, BACK) for action in range(len(ACTIONS))])
            tables.append(after.masked_fill(moves & ~best.taken, -1))
        again = again_costs(best.cost, self.memory.repeated, self.memory.turn, steps=False)
        for outcome in tables:
            costs = cheapest(torch.where(outcome < 0, best.cost, again), outcome, nowhere, best.here)
            if costs.isfinite().any():
                return int(costs.argmin())
        return None

    def map(self) -> PlaceMap:
        """Return the most probable map; in a tour without doubles of places."""
        best = self.best
        assert best is not None
        assert self.seen is not None
        best = best.compact()
        if self.arrows is not None:
            best = without_doubles(best, self.odds)
        return PlaceMap(replace(best, action=torch.full_like(best.action, -1)), self.seen)


def without_doubles(places: Places, odds: list[Tensor]) -> Places:
    """Return a tour's map in which places are one that look like one in the mean of all their visits.

    A walker who does not recognise a place makes it twice. Later visits know better, but a filter does not go back.
    Places with other arrows are never one, nor are those that a move connects, or whose moves lead to different places.
    They are those of one agent, all of them used; for ``odds`` see `ParticleMapper.odds`.
    """
    while True:
        similar = similarity(places, odds).masked_fill(contrary(places), -math.inf)
        if not (similar > DOUBLE).any():
            return places
        pair, turned = divmod(int(similar.argmax()), places.turns)
        kept, double = divmod(pair, len(similar))
        places = merged(places, double, kept, -turned).compact()


def similarity(places: Places, odds: list[Tensor]) -> Tensor:
    """Return the mean log odds of all visits that two places are one, turned by each angle, float32 ``[P, P, K]``.

    Turned by r, heading h of the first place is heading h + r of the second.
    """
    turns, count, node = places.turns, places.position.shape[1], places.node[0]
    before = len(node) - len(odds)
    later = torch.cat([torch.full((len(known),), before + at) for at, known in enumerate(odds)])
    earlier = torch.cat([torch.arange(len(known)) for known in odds])
    total = torch.cat(odds)
    turned = (node[earlier, None] + torch.arange(turns) - node[later, None]) % turns
    pair = ((node[later] // turns * count + node[earlier] // turns) * turns)[:, None] + turned
    sums = torch.zeros(2, count * count * turns)
    sums[0].scatter_add_(0, pair.flatten(), total.flatten())
    sums[1].scatter_add_(0, pair.flatten(), torch.ones_like(total).flatten())
    sums = sums.view(2, count, count, turns)
    sums = sums + sums.transpose(1, 2).flip(3).roll(1, 3)  # seen from the other place, the angle is the opposite one
    return torch.where(sums[1] > 0, sums[0] / sums[1], -math.inf)


def contrary(places: Places) -> Tensor:
    """Return whether arrows or moves rule out that two places are one, turned by each angle, bool ``[P, P, K]``."""
    turns, moves = places.turns, torch.tensor([AHEAD, BACK])
    arrows = places.cost[0][:, moves].isfinite().unflatten(0, (-1, turns))  # [P, K, 2]
    beyond = torch.where(places.taken[0], places.after[0] // turns, -1)[:, moves].unflatten(0, (-1, turns))
    ruled_out = torch.empty(len(arrows), len(arrows), turns, dtype=torch.bool)
    for turned in range(turns):
        there, target = arrows.roll(-turned, 1), beyond.roll(-turned, 1)
        apart = (beyond[:, None] >= 0) & (target >= 0) & (beyond[:, None] != target)
        ruled_out[..., turned] = ((arrows[:, None] != there) | apart).flatten(2).any(2)
    place = torch.arange(len(arrows))
    origin, led = place[:, None, None].expand_as(beyond)[beyond >= 0], beyond[beyond >= 0]
    ruled_out[origin, led] = ruled_out[led, origin] = ruled_out[place, place] = True
    return ruled_out


def merged(places: Places, double: int, kept: int, turned: int) -> Places:
    """Return a map in which one place is another: its heading h is heading ``h + turned`` of that which is kept."""
    turns = places.turns
    heading = torch.arange(turns)
    old, new = turns * double + heading, turns * kept + (heading + turned) % turns
    renamed = torch.arange(places.cost.shape[1])
    renamed[old] = new
    after, taken = places.after.clone(), places.taken.clone()
    better = (after[:, new] < 0) | (taken[:, old] & ~taken[:, new])
    after[:, new] = torch.where(better & (after[:, old] >= 0), after[:, old], after[:, new])
    taken[:, new] |= taken[:, old]
    cost = places.cost.clone()
    cost[:, new], cost[:, old] = torch.minimum(cost[:, new], cost[:, old]), math.inf
    after = torch.where(after < 0, -1, renamed[after.clamp(min=0)])
    return replace(places, after=after, taken=taken, cost=cost, node=renamed[places.node])


def resampled(probability: Tensor, generator: torch.Generator) -> Tensor:
    """Return particles sampled by their probabilities, float32 ``[K]``, with one random number for all of them."""
    count = len(probability)
    at = (torch.arange(count) + torch.rand(1, generator=generator)) / count
    return torch.searchsorted(probability.cumsum(0), at).clamp(max=count - 1)
