"""Recognising places and goals (paper section 3.4): what a recogniser is, the paper's choice, and the stop by it.

A `Recogniser` is of the component group ``recogniser``. `VisitScores` are its scores in a world, computed once and
looked up; a `TemplateStop` says by them where agents stop.
"""

import hashlib
import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, Protocol, Self, runtime_checkable

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dirl.config.components import Options, make, tried
from dirl.config.schemas import ConfigError, Match
from dirl.scenes.world import World

FRONT_THRESHOLD = 0.95
"""Above which one photo matches: other places are more like a goal in one view than in four, see docs/decisions.md."""

CERTAIN = 20.0
"""Log odds that leave no doubt."""

StopRule = Callable[[Tensor, Tensor], Tensor]
"""From goals, by their place among a world's goals plus G times their look, and the view ahead, by view id, int64
``[...]`` each, to whether an agent stops there, bool ``[...]``."""

ScoreFunction = Callable[[Tensor, Tensor], Tensor]
"""The same, but to the scores, float32 ``[...]``."""


class Thresholds(NamedTuple):
    """Above which scores two visits are of the same place and heading."""

    views: float
    """Where an agent stops that is given four views of its goal."""
    photo: float
    """Where it stops that is given one."""
    memory: float
    """Which earlier visit of the episode this one repeats."""


class Recogniser(Protocol):
    """Compares what is seen at one visit of a place with what was seen at another.

    A *visit* is the views of one moment: ahead, right, back and left. Views are described once, and the descriptions
    compared as often as needed.
    """

    reads_patches: bool
    """Whether `describe` needs the patches of the views."""

    calibrated: bool
    """Whether its scores are log odds."""

    thresholds: Thresholds | None
    """Its own; None where the configuration of the stop and the memory gives them."""

    def fit(self, features: Tensor, patches: Tensor | None = None) -> Self:
        """Return the recogniser for a place.

        Args:
            features: pooled ones of N views of the place, float ``[N, D]``.
            patches: of the same views, float ``[N, cells, channels]``.
        """

    def describe(self, features: Tensor, patches: Tensor | None = None) -> Tensor:
        """Return what is compared of views.

        Args:
            features: pooled ones, float ``[..., D]``.
            patches: of the same views, float ``[..., cells, channels]``.

        Returns:
            float32 ``[..., F]``.
        """

    def scores(self, seen: Tensor, references: Tensor) -> Tensor:
        """Return how much each visit looks like each reference.

        Args:
            seen: described views of visits, float32 ``[..., A, 4, F]``.
            references: of visits, ``[..., B, 4, F]``, or of single photos, ``[..., B, 1, F]``.

        Returns:
            float32 ``[..., A, B]``; higher is more alike. Minus infinity: the visit shows nothing that could tell.
        """


@runtime_checkable
class ComparesPanoramas(Protocol):
    """A recogniser whose descriptions have a part by which whole panoramas are compared, see `panorama_odds`."""

    def whole(self, described: Tensor) -> Tensor:
        """Return that part of described views, float32 ``[..., F]`` to ``[..., W]``; neither centred nor whitened."""


PANORAMA_SLOPE, PANORAMA_MIDDLE, PANORAMA_GROWTH = 50.0, 0.05, 0.027
"""Log odds by the mean cosine of two panoramas, and by the logarithm of how many the place is known by, with which all
cosines grow. Chosen on walks in two real tours with photographs that changed; see docs/decisions.md."""


PLACES_UNSEEN = 250
"""A goal is told from places not seen yet, too: it counts as one of so many panoramas at least. Else early stops are
often wrong."""


def panorama_odds(seen: Tensor, wanted: Tensor, place: Tensor | None = None) -> Tensor:
    """Return the log odds that panoramas are of one place, by all views at once.

    In a panorama whose headings lie 45 degrees apart, four views are alike at several of them, and a recogniser that
    learned in rooms confuses these. All views together do not, once they are whitened by those of this place: what many
    of them share says little.

    Args:
        seen: of T panoramas of K views, float32 ``[B, T, K, W]``; see `ComparesPanoramas`.
        wanted: the panorama that is looked for, ``[B, K, W]``, or four views of it, 90 degrees apart.
        place: if a goal is wanted, the panoramas of the place, by which all are whitened; else those of ``seen`` are.

    Returns:
        float32 ``[B, T, K]``: facing each view of each panorama, that what is ahead is ``wanted``'s first view.
    """
    known = seen.shape[1] if place is None else max(place.shape[1], PLACES_UNSEEN)
    place = seen if place is None else place
    views = torch.cat([place.flatten(1, 2), wanted], 1)
    headings, count = seen.shape[2], wanted.shape[1]
    mean = views.mean(1, keepdim=True)
    centred = views - mean
    covariance = centred.mT @ centred / views.shape[1]
    # As much as the mean variance is added: a few views tell little of so many directions.
    floor = covariance.diagonal(dim1=1, dim2=2).sum(1) / min(views.shape[1:])
    identity = torch.eye(views.shape[2], device=views.device)
    factor = torch.linalg.cholesky(covariance + (floor + 1e-6)[:, None, None] * identity)
    around, ahead = (
        F.normalize(torch.linalg.solve_triangular(factor, (each - mean).mT, upper=False).mT, dim=-1)
        for each in (seen.flatten(1, 2), wanted)
    )
    cosines = torch.einsum("btkw,bvw->btkv", around.unflatten(1, seen.shape[1:3]), ahead)
    aside = torch.arange(count, device=seen.device) * (headings // count)
    facing = (torch.arange(headings, device=seen.device)[:, None] + aside) % headings
    mean_cosine = cosines.gather(2, facing.expand(*cosines.shape[:2], -1, -1)).mean(-1)
    middle = PANORAMA_MIDDLE + PANORAMA_GROWTH * math.log(max(known, 1))
    return PANORAMA_SLOPE * (mean_cosine - middle)


class NCC(nn.Module):
    """Normalised cross-correlation of the pooled features of all views together (paper section 3.4, equation 13).

    Args:
        returned: where views return bit for bit, the correlation above which one has returned. Then scores are log odds
            that leave no doubt.
    """

    reads_patches = False
    calibrated = False
    thresholds: Thresholds | None = None

    def __init__(self, returned: float | None = None) -> None:
        super().__init__()
        self.returned = returned
        if returned is not None:
            self.calibrated = True

    def fit(self, features: Tensor, patches: Tensor | None = None) -> Self:
        """Return itself: it has no statistics."""
        return self

    def describe(self, features: Tensor, patches: Tensor | None = None) -> Tensor:
        """Return the features themselves; see `Recogniser.describe`."""
        return features.float()

    def scores(self, seen: Tensor, references: Tensor) -> Tensor:
        """Return Pearson's coefficients, in [-1, 1], of as many views as references have; see `Recogniser.scores`."""
        seen = seen[..., : references.shape[-2], :]
        correlation = normal_vectors(seen.flatten(-2)) @ normal_vectors(references.flatten(-2)).transpose(-1, -2)
        return correlation if self.returned is None else torch.where(correlation > self.returned, CERTAIN, -CERTAIN)


def ncc(observation: Tensor, goal: Tensor) -> Tensor:
    """Return normalised cross-correlation of feature vectors, Pearson's coefficient (paper equation 13).

    Of float ``[..., D]``, broadcast, to ``[...]`` in [-1, 1]; 0 where one of the vectors is constant.
    """
    return (normal_vectors(observation) * normal_vectors(goal)).sum(-1)


def normal_vectors(vector: Tensor) -> Tensor:
    """Return vectors, float ``[..., D]``, without their mean and of length one; the product of two is their `ncc`."""
    centred = vector - vector.mean(-1, keepdim=True)
    # The mean of a constant vector is rounded; the remainder must not be normalised to length one.
    constant = vector.amax(-1, keepdim=True) == vector.amin(-1, keepdim=True)
    return F.normalize(centred.masked_fill(constant, 0.0), dim=-1)


def in_blocks(recogniser: Recogniser, seen: Tensor, references: Tensor, block: int = 256) -> Tensor:
    """Return `Recogniser.scores` of many visits, ``[A, V, F]`` and ``[B, V, F]``, computed ``block`` rows at a time."""
    return torch.cat([recogniser.scores(rows, references) for rows in seen.split(block)])


def build_recogniser(
    options: Options, device: torch.device | str = "cpu", trust: Collection[str] | None = None
) -> Recogniser:
    """Make the recogniser of the stop and the episodic memory, which may be of a user's own; `NCC` by default.

    ``trust`` is as for `dirl.config.components.find_class`.

    Raises:
        ConfigError: it cannot be made, or lacks a member of `Recogniser`.
    """
    recogniser: Any = make("recogniser", options, trust) or NCC()
    if isinstance(recogniser, nn.Module):
        recogniser = recogniser.to(device)
    # Its methods have been looked for in its class.
    if missing := [name for name in ("reads_patches", "calibrated", "thresholds") if not hasattr(recogniser, name)]:
        raise ConfigError(f"recogniser: {type(recogniser).__name__} has no {', '.join(missing)}")
    if not isinstance(recogniser.thresholds, Thresholds | None):
        raise ConfigError(
            f"recogniser: {type(recogniser).__name__}.thresholds must be Thresholds of dirl or None, "
            f"not {type(recogniser.thresholds).__name__}"
        )
    return recogniser


def set_memory_threshold(memory: nn.Module | None, recogniser: Recogniser) -> None:
    """Give an episodic memory the threshold of its recogniser; one without a threshold weighs log odds itself.

    Raises:
        ConfigError: the memory weighs log odds, and the recogniser's scores are none.
    """
    if memory is None:
        return
    if not hasattr(memory, "threshold"):
        if not recogniser.calibrated:
            raise ConfigError(
                f"episodic_memory=localising weighs log odds, and {type(recogniser).__name__} has none: "
                "add recogniser=learned"
            )
        memory.exact = isinstance(recogniser, NCC) and recogniser.returned is not None  # type: ignore[assignment]
    elif recogniser.thresholds is not None:
        memory.threshold = recogniser.thresholds.memory  # type: ignore[assignment]


def recogniser_name(recogniser: Recogniser) -> str:
    """Return the class of a recogniser and a digest of its weights: others cannot compare its descriptions."""
    kind = type(recogniser)
    digest = hashlib.sha256()
    if isinstance(recogniser, nn.Module):
        for name, value in sorted(recogniser.state_dict().items()):
            digest.update(name.encode() + value.detach().cpu().contiguous().numpy().tobytes())
    return f"{kind.__module__}.{kind.__qualname__} sha256:{digest.hexdigest()[:16]}"


PAIRS = 256
"""Visits that are compared with a reference each at a time: a hundred megabytes."""


class VisitScores:
    """The scores between every two visits of each scene of a world.

    A visit is named by its first view id, ``look * N + state``: the other three follow from it. Scores are computed
    when they are first asked for: in a world of one look all of a reference, in one that changes, where a visit hardly
    ever returns, no others.

    Args:
        recogniser: compares them.
        world: N states in L looks each.
        match: ``views``, all four of them, or ``front``, the one ahead.
    """

    @torch.no_grad()
    def __init__(self, recogniser: Recogniser, world: World, match: str = "views") -> None:
        self.recogniser, self.match, self.looks = recogniser, match, world.looks
        self.visits = [described_visits(recogniser, world, index) for index in range(len(world.scenes))]
        sizes = torch.tensor([len(visits) for visits in self.visits], device=world.device)
        order = torch.cat([world.pictures(index) for index in range(len(world.scenes))]).argsort()
        self.scene = torch.arange(len(sizes), device=world.device).repeat_interleave(sizes)[order]
        self.column = torch.cat([torch.arange(size, device=world.device) for size in sizes.tolist()])[order]
        self.row = (sizes**2).cumsum(0)[self.scene] - sizes[self.scene] * (sizes[self.scene] - self.column)
        self.table = torch.empty(int((sizes**2).sum()), device=world.device)
        self.known = torch.zeros_like(self.table, dtype=torch.bool)
        self.whole: Tensor | None = None
        """What panoramas are compared by, of each view id, float32 ``[M, W]``; None = four views at a time are."""
        if isinstance(recogniser, ComparesPanoramas):
            self.whole = torch.cat([recogniser.whole(visits[:, 0]) for visits in self.visits])[order]

    def __call__(self, reference: Tensor, seen: Tensor) -> Tensor:
        """Return scores, float32, of visits by their first view ids in one scene, int64 ``[...]`` each, broadcast."""
        reference, seen = torch.broadcast_tensors(reference, seen)
        entry = self.row[reference] + self.column[seen]
        asked = ~self.known[entry]
        if asked.any():
            self._compute(reference[asked], seen[asked])
        return self.table[entry]

    def of_visits(self, seen: Tensor, visit: Tensor) -> Tensor:
        """Compare visits ``[B, K]`` with earlier ones, ``[B, T, K]``, by view ids; return a score facing each view.

        A node faces the view that was ahead or aside, by whose view id it is named. Of a panorama each four views, 90
        degrees apart, are compared, and the mean is taken, unless the recogniser `ComparesPanoramas`.
        """
        rings = visit.shape[1] // self.visits[0].shape[1]
        if rings > 1 and self.whole is not None:
            return panorama_odds(self.whole[seen], self.whole[visit])
        scores = [self(seen.roll(-ring, 2), visit[:, None, ring, None]) for ring in range(rings)]
        return torch.stack(scores).mean(0) if rings > 1 else scores[0]

    def of_goal(self, goal: Tensor, visits: Tensor, place: Tensor) -> Tensor:
        """Return the log odds that panoramas see goals, by their view ids; see `panorama_odds`."""
        assert self.whole is not None
        return panorama_odds(self.whole[visits], self.whole[goal], self.whole[place])

    @torch.no_grad()
    def _compute(self, reference: Tensor, seen: Tensor) -> None:
        """Fill in what is asked for, by view ids, int64 ``[A]`` each."""
        for index in self.scene[reference].unique().tolist():
            visits, inside = self.visits[index], self.scene[reference] == index
            if self.looks == 1:
                wanted = reference[inside].unique()
                entry = self.row[wanted][:, None] + torch.arange(len(visits), device=wanted.device)
                self.table[entry] = in_blocks(self.recogniser, visits, self._references(visits, wanted)).T
                self.known[entry] = True
                continue
            for wanted, shown in zip(reference[inside].split(PAIRS), seen[inside].split(PAIRS), strict=True):
                entry = self.row[wanted] + self.column[shown]
                pairs = visits[self.column[shown], None], self._references(visits, wanted)[:, None]
                self.table[entry] = self.recogniser.scores(*pairs).flatten()
                self.known[entry] = True

    def _references(self, visits: Tensor, wanted: Tensor) -> Tensor:
        """Return the described visits of one scene that are references, by view ids, ``[A]`` to ``[A, V, F]``."""
        references = visits[self.column[wanted]]
        return references[:, :1] if self.match == "front" else references


def described_visits(recogniser: Recogniser, world: World, index: int) -> Tensor:
    """Return the described views of one scene's visits, float32 ``[M, 4, F]``, in the order of `World.pictures`."""
    pictures, states, offset = world.pictures(index), len(world.scenes[index]), world.offsets[index]
    patches = None if world.patches is None or not recogniser.reads_patches else world.patches[pictures]
    features = world.features[pictures]
    with tried("recogniser", recogniser):
        own = recogniser.fit(features[:states], None if patches is None else patches[:states])
        views = own.describe(features, patches)
        if views.ndim != 2 or len(views) != len(features):
            raise ValueError(f"describe gave {list(views.shape)} for {len(features)} views; expected [N, F]")
        visit = views[:4].unsqueeze(0)
        scores = own.scores(visit.repeat(2, 1, 1), visit.repeat(3, 1, 1))
        if scores.shape != (2, 3):
            raise ValueError(f"scores gave {list(scores.shape)} for 2 visits and 3 references; expected [2, 3]")
    local = world.surrounding[offset : offset + states] - offset
    return views[torch.cat([local + look * states for look in range(world.looks)])]


@dataclass(frozen=True)
class TemplateStop:
    """Stop where the observation matches the goal.

    Args:
        threshold: stop above this coefficient (the paper's is 0.9).
        match: what is compared: ``views``, all four of them, or ``front``, the one ahead.
        recogniser: compares it; the paper's is template matching by correlation.
    """

    threshold: float = 0.9
    match: Literal["views", "front"] | Match = "views"
    recogniser: Recogniser = field(default_factory=NCC, compare=False)

    def __post_init__(self) -> None:
        if self.match not in ("views", "front"):
            raise ValueError(f"match is 'views' or 'front', not '{self.match}'")

    @torch.no_grad()  # a learned recogniser has weights
    def scores(self, world: World) -> Tensor:
        """Return the score of every pair of a goal and a state of its scene, float32 ``[P]``, see `World.pair`.

        In a world that changes both are seen in their default look.
        """
        scores = []
        for index, scene in enumerate(world.scenes):
            visits = described_visits(self.recogniser, world, index)[: len(scene)]
            goals = visits[world.local_goals(index)]
            goals = goals[:, :1] if self.match == "front" else goals
            scores.append(in_blocks(self.recogniser, visits, goals).T.flatten())
        return torch.cat(scores)

    def __call__(self, world: World) -> Tensor:
        """Return where an agent stops on its way to each goal, bool ``[P]``: never where no path leads to it."""
        return (self.scores(world) > self.threshold) & (world.distances >= 0)

    def arrived(self, world: World) -> StopRule:
        """Return the stop in a world that changes, where it depends on the looks of the goal and of the visit."""
        compared = self.compared(world)
        return lambda wanted, picture: compared(wanted, picture) > self.threshold

    def compared(self, world: World) -> ScoreFunction:
        """Return the scores by which an agent would stop, for one that weighs them itself."""
        scores, states, goals = VisitScores(self.recogniser, world, self.match), len(world), len(world.goals)
        return lambda wanted, picture: scores(world.goals[wanted % goals] + wanted // goals * states, picture)


def stop_by(recogniser: Recogniser, threshold: float, match: Match) -> TemplateStop:
    """Make the stop by a recogniser, above its own threshold or, if it has none, the one given."""
    if recogniser.thresholds is not None:
        threshold = recogniser.thresholds.photo if match == "front" else recogniser.thresholds.views
    return TemplateStop(threshold, match, recogniser)
