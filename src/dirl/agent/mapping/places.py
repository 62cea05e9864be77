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

BLOCKED = 0.1
"""Prior probability that a move of a walk is blocked: a walk tries all moves, an agent those that a policy likes."""


@dataclass(frozen=True)
class PlaceMap:
    """What one walk of T visits found out about a place with P places where the walker can stand."""

    places: Places
    """Of one agent; see `dirl.models.localising.Places`."""
    seen: Tensor
    """The visits, by view ids or by described views, ``[1, T, V, ...]``."""

    def __len__(self) -> int:
        """The number of nodes, K P."""
        return self.places.cost.shape[1]

    @property
    def turns(self) -> int:
        """Right turns in a full circle, K."""
        return self.places.turns

    def begin(self, goal: Tensor) -> Places:
        """What agents know that walked here once and now begin an episode, at a place that they do not know.

        ``goal`` is the log odds that their goals are seen at each visit of the walk, facing each view, ``[B, T, V]``.
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
        self.places: Places | None = None
        if known is not None:
            self.turns, self.places = known.turns, known.begin(known.places.goal.expand(particles, -1, -1))
        self.weight = torch.zeros(particles)
        self.generator = torch.Generator().manual_seed(seed)

    @property
    def best(self) -> Places | None:
        """The most probable particle, as one agent; None before the first visit."""
        return None if self.places is None else self.places.select(self.weight.argmax()[None])

    @torch.no_grad()
    def see(self, visit: Tensor, action: int | None = None) -> int:
        """Take in what is seen around the walker: the node where it most probably is.

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
        likely = self.memory.likely(self.places, alike)
        here = torch.multinomial(likely.softmax(1), 1, generator=self.generator).squeeze(1)
        cost = torch.full((particles, views, len(ACTIONS)), UNASKED)
        if self.arrows is not None:
            cost = cost.masked_fill(~self.arrows(visit).cpu(), math.inf)  # impossible moves: neither tried nor guessed
        self.places = self.memory.add(self.places, here, torch.zeros(particles, views), lambda _: cost)
        self.weight = self.weight + likely.logsumexp(1)
        probability = self.weight.softmax(0)
        if 1 / probability.square().sum() < particles / 2:
            self.places = self.places.select(resampled(probability, self.generator))
            self.weight = torch.zeros(particles)
        return int(self.places.node[self.weight.argmax(), -1])

    def frontier_action(self) -> int | None:
        """The first action of a shortest path to one with an unknown outcome; None without any, or before a visit.

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
            found = cheapest(torch.where(outcome < 0, best.cost, again), outcome, nowhere, best.here)
            if found.isfinite().any():
                return int(found.argmin())
        return None

    def map(self) -> PlaceMap:
        """The most probable map."""
        best = self.best
        assert best is not None
        assert self.seen is not None
        return PlaceMap(replace(best.compact(), action=torch.full_like(best.action, -1)), self.seen)


def resampled(probability: Tensor, generator: torch.Generator) -> Tensor:
    """Indices of particles sampled by their probabilities, float32 ``[K]``, with one random number for all of them."""
    count = len(probability)
    at = (torch.arange(count) + torch.rand(1, generator=generator)) / count
    return torch.searchsorted(probability.cumsum(0), at).clamp(max=count - 1)
