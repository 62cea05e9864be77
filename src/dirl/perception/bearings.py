"""In which direction another panorama was taken: the geometry of points that both see.

Both are level. So a point has the same height over both, and the same distance from the line through both: seen at
azimuths a and b from the way that leads from one to the other, and at elevations e and f,

    tan(e) sin(b) = tan(f) sin(a),

on the same side, and from the second farther back than from the first. Every two directions, of the way and of how the
second is turned, are tried, which is exact enough for arrows and needs no robust estimator.
"""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from dirl.perception.matching import Described, Matcher, angles, mutual
from dirl.perception.recognition.other_cameras import Panorama

SIZE, FIELD_OF_VIEW = 384, 75.0
"""Pixels a side and degrees of the views whose points are matched."""

ALONG = 40.0
"""Degrees of the view along an arrow; what is farther away is small in those of headings."""

POINTS = 300
"""Points of each view that are matched, the clearest."""

ALIKE = 0.82
"""Least cosine of the vectors of two points."""

AROUND = 4
"""Views of a goal, by turns of 90 degrees."""

NEIGHBOURS = 24
"""Panoramas that are compared with each, the most alike as a whole."""

STEP = 5
"""Degrees between the directions that are tried."""

TOLERANCE, LEVEL = 0.02, 0.1
"""How far a point may be off, radians; and the elevations, together, from which on a point tells anything."""

BESIDE, ELSEWHERE = 3, 8
"""Steps from an arrow within which points speak for it, and beyond which they speak against it."""

CHANCE, SURE = 1.0, 5.0
"""Deviations of a Poisson count by which the points along an arrow must exceed those elsewhere to count at all, and to
leave no doubt."""


def directions(positions: NDArray[np.float32], yaw: float) -> Tensor:
    """Return azimuth and elevation of pixels ``[P, 2]`` of a level view at ``yaw`` degrees, radians, ``[P, 2]``."""
    focal = SIZE / 2 / np.tan(np.radians(FIELD_OF_VIEW / 2))
    aside = (torch.from_numpy(positions) - SIZE / 2) / focal * torch.tensor([1.0, -1.0])
    return angles(aside) + torch.tensor([np.radians(yaw), 0.0], dtype=torch.float32)


def support(here: Tensor, there: Tensor, view: Tensor, views: int) -> Tensor:
    """Return how many matches agree that a panorama lies in a direction and is turned by an angle.

    Args:
        here: azimuths and elevations of M points, radians clockwise and upwards, float32 ``[M, 2]``.
        there: of the same points as the other panorama sees them.
        view: which of the other's views sees each, int64 ``[M]``.
        views: how many it has.

    Returns:
        float32 ``[D, D, views]``: by direction and by angle, each in steps of `STEP` degrees.
    """
    telling = here[:, 1].abs() + there[:, 1].abs() > LEVEL
    here, there, of_view = here[telling], there[telling], F.one_hot(view[telling], views).float()
    steps = torch.arange(0, 360, STEP).deg2rad()
    first, second = here[:, 0] - steps[:, None], there[:, 0] + steps[:, None]  # [D, M]
    low, high = here[:, 1].tan(), there[:, 1].tan()
    scale = (1 + low**2 + high**2).sqrt()
    sine, cosine = second.sin(), second.cos()
    counts = []
    for across, ahead in zip(first.sin(), first.cos(), strict=True):
        on_one_plane = ((low * sine - high * across) / scale).abs() < TOLERANCE
        on_one_side = sine * across > -1e-3
        farther_back = (sine * ahead - cosine * across) * across.sign() > -0.01
        counts.append((on_one_plane & on_one_side & farther_back).float() @ of_view)
    return torch.stack(counts)


def clearness(count: Tensor, arrow: float) -> Tensor:
    """Return how clearly points tell that another panorama lies along an arrow, 0 to 1, ``[...]``.

    Args:
        count: of points that agree, by direction, float32 ``[D, ...]``.
        arrow: where it points, degrees clockwise.
    """
    away = (torch.arange(len(count)) - round(arrow / STEP)) % len(count)
    away = torch.minimum(away, len(count) - away)
    along, elsewhere = count[away <= BESIDE].amax(0), count[away > ELSEWHERE].amax(0)
    excess = (along - elsewhere) / (elsewhere + 5).sqrt()
    return ((excess - CHANCE) / (SURE - CHANCE)).clamp(0, 1)


def toward(
    matcher: Matcher, views: Iterable[NDArray[np.uint8]], yaws: NDArray[np.float64], arrows: NDArray[np.float64]
) -> Iterator[NDArray[np.float16]]:
    """Yield for each of P panoramas how clearly its arrows lead to every state, float16 ``[2, K, P * K]``.

    Of a state the four views around it are known, or, in the second table, the one ahead alone.

    Args:
        matcher: finds the points.
        views: of `SIZE` pixels a side, K of each panorama, uint8 ``[SIZE, SIZE, 3]``.
        yaws: where they look, degrees clockwise, ``[P, K]``.
        arrows: where the arrow of each state points, likewise; nan where there is none.
    """
    turns = yaws.shape[1]
    described = matcher.describe(views)
    panoramas = [_points(described, place * turns, of_place) for place, of_place in enumerate(yaws.tolist())]
    whole = F.normalize(described.whitened.unflatten(0, yaws.shape).sum(1), dim=1)
    for place, alike in enumerate(whole @ whole.T):
        clear = torch.zeros(2, turns, *yaws.shape)
        for other in alike.topk(min(NEIGHBOURS + 1, len(whole))).indices.tolist():
            if other != place:
                clear[:, :, other] = _toward(panoramas[place], panoramas[other], arrows[place].tolist())
        yield clear.flatten(2).half().numpy()


class GoalBearing:
    """Along which arrow a goal lies, for an agent with cameras; `toward` says so of all goals of a tour beforehand.

    Args:
        views: the four around the goal, level.

    Raises:
        ImportError: XFeat is not installed.
    """

    def __init__(self, views: Panorama) -> None:
        self.goal = _points_around(views)

    def clear(self, views: Panorama) -> Tensor:
        """Return how clearly the arrow of each of K level views leads to the goal, 0 to 1, float32 ``[K]``."""
        count = _agreeing(_points_around(views), self.goal, AROUND).sum(2).amax(1)
        return torch.stack([clearness(count, 360 / len(views) * view) for view in range(len(views))])


def _points_around(views: Panorama) -> tuple[Tensor, Tensor, Tensor]:
    """Return `_joined` points of views at equal turns, the first one ahead."""
    found = [views.points(view) for view in range(len(views))]
    ahead = [torch.tensor([2 * np.pi / len(views) * view, 0.0], dtype=torch.float32) for view in range(len(views))]
    seen = [directions[:POINTS] + yaw for (directions, _), yaw in zip(found, ahead, strict=True)]
    return _joined(seen, [vectors[:POINTS] for _, vectors in found])


def _points(described: Described, first: int, yaws: Sequence[float]) -> tuple[Tensor, Tensor, Tensor]:
    """Return `_joined` points of a panorama's views, which begin with the ``first``."""
    views = [described.points(first + view) for view in range(len(yaws))]
    seen = [directions(positions[:POINTS], yaw) for (positions, _), yaw in zip(views, yaws, strict=True)]
    return _joined(seen, [vectors[:POINTS] for _, vectors in views])


def _joined(seen: Sequence[Tensor], vectors: Sequence[Tensor]) -> tuple[Tensor, Tensor, Tensor]:
    """Return directions ``[M, 2]`` and vectors ``[M, C]`` of the points of views, and the view of each, ``[M]``."""
    counts = torch.tensor([len(points) for points in seen])
    return torch.cat(list(seen)), torch.cat(list(vectors)), torch.arange(len(seen)).repeat_interleave(counts)


def _agreeing(panorama: tuple[Tensor, ...], other: tuple[Tensor, ...], views: int) -> Tensor:
    """Return `support` of the points of a panorama that match those of one of the other's views each."""
    alike = panorama[1] @ other[1].T
    here, there = [other[2][:0]], [other[2][:0]]
    for view in range(views):
        points = torch.nonzero(other[2] == view)[:, 0]
        if len(points) and len(alike):
            first, second = mutual(alike[:, points], ALIKE)
            here.append(first)
            there.append(points[second])
    first, second = torch.cat(here), torch.cat(there)
    return support(panorama[0][first], other[0][second], other[2][second], views)


def _toward(panorama: tuple[Tensor, ...], other: tuple[Tensor, ...], arrows: Sequence[float]) -> Tensor:
    """Return how clearly each of K arrows of one panorama leads to the K states of another, ``[2, K, K]``."""
    turns = len(arrows)
    agree = _agreeing(panorama, other, turns)
    quarter = turns // AROUND
    around = torch.stack([agree.roll(-turn * quarter, 2) for turn in range(AROUND)]).sum(0)
    clear = torch.zeros(2, turns, turns)
    for arrow, of_arrow in enumerate(arrows):
        if np.isfinite(of_arrow):
            for table, count in enumerate((around, agree)):
                clear[table, arrow] = clearness(count.amax(1), of_arrow)
    return clear
