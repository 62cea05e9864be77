"""Whether a panorama shows what a photo of another camera shows: the rotation on which matched points agree.

`Learned` compares what is where in two pictures, and another focal length or direction moves everything. Seen from one
place, however, the points of two pictures differ by a single rotation, whatever the cameras. From another place near
things move against far ones, and fewer points agree.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from operator import itemgetter

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from dirl.perception.matching import angles, mutual, xfeat

VIEW, FIELD_OF_VIEW = 320, 75.0
"""Pixels that a view is made wide, and its horizontal field of view, degrees, where nothing tells it."""

FOCAL = VIEW / 2 / math.tan(math.radians(FIELD_OF_VIEW / 2))
"""Of views and photos, pixels: XFeat matches what is about equally large."""

WIDEST = 640
"""Pixels that a view is made wide at most."""

SHARED, SAME = 20, 0.03
"""So many points of neighbouring views, and half of all, have to tell the same focal length, to its logarithm."""

LEVEL = 0.03
"""How much higher a point may be in the next view, radians."""

SIDES = 256, 330
"""Pixels that the longer side of a photo is made whose focal length is unknown."""

FOCALS = 0.6, 0.65, 0.7, 0.76, 0.82, 0.89
"""Focal lengths of such a photo that are tried, in lengths of its longer side: 80 to 59 degrees. Beyond, a photo taken
here looks like one that was taken a step ahead."""

FEW = 60
"""A photo with fewer points tells nothing by them: it shows a blank wall, or is too small."""

LIKELY = 2
"""Views that are compared, the most alike as a whole."""

ALIKE = 0.75
"""Least cosine of the vectors of two points."""

MATCHES = 20, 160
"""Of two pictures: as so many count fewer, and at most so many are taken, the clearest."""

KNOWN, UNKNOWN = (0.03, 0.62), (0.02, 0.5)
"""Radians within which points agree, and the share of matches that agree at which log odds are even: where the focal
length is known, and where it is not."""

WEIGHT, LEAST = 12.0, -6.0
"""Log odds are ``WEIGHT * log(share / even)``, at least `LEAST`; chosen on real tours, see docs/decisions.md."""

EVEN_OF_FOUR, POSSIBLE = 0.27, -7.0
"""Share of the points of four views that agree on one rotation at which log odds are even, where places change much
(else `Localising.doubt` is taken off them), and the log odds of a recogniser above which the points are compared."""


class Panorama:
    """K views around a camera, whose points are found once, when asked for.

    Args:
        views: clockwise, by equal turns, RGB, uint8 ``[K, H, W, 3]``.
        field_of_view: of each, from left to right, degrees.
    """

    def __init__(self, views: NDArray[np.uint8], field_of_view: float = FIELD_OF_VIEW) -> None:
        self.views, self.field_of_view = views, field_of_view
        self._found: dict[int, tuple[Tensor, Tensor]] = {}

    def __len__(self) -> int:
        return len(self.views)

    def points(self, view: int) -> tuple[Tensor, Tensor]:
        """Return `view_points` of the view with this number; beyond the last one follows the first."""
        view %= len(self)
        if view not in self._found:
            self._found[view] = view_points(self.views[view], self.field_of_view)
        return self._found[view]


class PhotoPoints:
    """The points of one photo, found by XFeat (``pip install 'dirl[match]'``).

    Args:
        photo: RGB, uint8 ``[H, W, 3]``.
        field_of_view: from left to right, degrees; None where it is unknown.
    """

    def __init__(self, photo: NDArray[np.uint8], field_of_view: float | None = None) -> None:
        longer, width = max(photo.shape[:2]), photo.shape[1]
        self.tolerance, self.even = UNKNOWN if field_of_view is None else KNOWN
        focals: tuple[float, ...] = FOCALS
        sides: tuple[int, ...] = SIDES
        if field_of_view is not None:
            focal = width / longer / 2 / math.tan(math.radians(field_of_view / 2))
            focals, sides = (focal,), (round(FOCAL / focal),)
        parts = [_points(_resized(photo, side / longer), side) for side in sides]
        places, self.vectors = torch.cat([part[0] for part in parts]), torch.cat([part[1] for part in parts])
        self.directions = [angles(places / focal) for focal in focals]
        """Of the points, by each focal length that is tried."""
        self.enough = len(places) >= FEW
        """Whether there are enough to tell anything."""

    def log_odds(self, seen: Panorama, likeness: Tensor) -> Tensor:
        """Return the log odds that the photo was taken here, facing each of K views, float32 ``[K]``.

        Args:
            seen: the views.
            likeness: of each view as a whole to the photo, float32 ``[K]``.
        """
        turns = len(seen)
        odds = torch.full((turns,), LEAST)
        for view in likeness.topk(LIKELY).indices.tolist():
            share, yaw = _agree(self.directions, self.vectors, seen.points(view), self.tolerance)
            facing = (view + round(yaw * turns / 360)) % turns
            odds[facing] = max(float(odds[facing]), _log_odds(share, self.even))
        return odds


class GoalPoints:
    """The points of four views of a goal, as `PhotoPoints` has those of one photo.

    Args:
        views: clockwise, by 90 degrees.
    """

    def __init__(self, views: Panorama) -> None:
        found = [views.points(quarter) for quarter in range(len(views))]
        self.quarters = len(views)
        self.views = [(quarter, points) for quarter, points in enumerate(found) if len(points[0]) >= FEW]

    def confirmed(self, odds: Tensor, seen: Panorama) -> Tensor:
        """Return log odds that the goal is seen facing each view, float32 ``[K]``: by points where they are highest.

        Where even these are low, or the goal's views are blank, they are returned as they are.
        """
        if odds.max() <= POSSIBLE or not self.views:
            return odds
        turns, told = len(seen), odds.clamp(max=LEAST)
        for view in odds.topk(LIKELY).indices.tolist():
            if odds[view] > POSSIBLE:
                share, yaw = self._share(seen, view)
                facing = (view + round(yaw * turns / 360)) % turns
                told[facing] = max(float(told[facing]), _log_odds(share, EVEN_OF_FOUR))
        return told

    def _share(self, seen: Panorama, view: int) -> tuple[float, float]:
        """Return the share of all points that agree on one rotation if this view is the goal's first, and its azimuth.

        See `_agree`. Each of the four views has its matches, but from one place all of them are turned alike.
        """
        turned = []
        for quarter, (directions, vectors) in self.views:
            first, there = _matched(vectors, seen.points(view + len(seen) // self.quarters * quarter))
            turned.append(there - directions[first])
        agreeing, yaw = _agreeing(torch.cat(turned), KNOWN[0])
        return agreeing / sum(max(MATCHES[0], len(each)) for each in turned), yaw


def view_points(view: NDArray[np.uint8], field_of_view: float) -> tuple[Tensor, Tensor]:
    """Return azimuths and elevations of the points of a level view, radians, ``[P, 2]``, and their vectors, ``[P, C]``.

    The view, RGB, uint8 ``[H, W, 3]``, is so many degrees wide.
    """
    half = math.tan(math.radians(field_of_view / 2))
    width = min(WIDEST, round(2 * half * FOCAL))
    places, vectors = _points(_resized(view, width / view.shape[1]), width / half / 2)
    return angles(places), vectors


def angle_of_views(seen: Panorama) -> float | None:
    """Return how wide each view of a panorama is, degrees, by the points that neighbours share; None if they share few.

    A point is seen at x in one view, and after a turn to the right by t at x'; so atan(x / f) = atan(x' / f) + t. This
    is a quadratic equation for the focal length f, which each point solves; most agree on the right one.

    Args:
        seen: more than four level views. Points are where they are for any angle that is assumed: f is in units of its.
    """
    step = max(1, len(seen) // 8)  # by a small turn little moves
    turn = math.tan(2 * math.pi * step / len(seen))
    focals = []
    for (here, vectors), (beside, of_beside) in pairwise(map(seen.points, range(0, len(seen), step))):
        if not len(here) or not len(beside):
            continue
        first, second = mutual(vectors @ of_beside.T, ALIKE)
        (x, up), (x_beside, up_beside) = _on_the_plane(here[first]), _on_the_plane(beside[second])
        apart = x - x_beside
        focal = (apart + (apart**2 - 4 * turn**2 * x * x_beside).clamp(min=0).sqrt()) / (2 * turn)
        rises = (up / (x**2 + focal**2).sqrt() - up_beside / (x_beside**2 + focal**2).sqrt()).abs()
        focals.append(focal[(x > 0) & (x_beside < 0) & (rises < LEVEL)])
    told = torch.cat([torch.empty(0), *focals]).log().sort().values
    same = torch.searchsorted(told, told + SAME) - torch.searchsorted(told, told - SAME)
    if len(told) < SHARED or same.max() < max(SHARED, len(told) / 2):
        return None
    agreed = float(told[(told - told[same.argmax()]).abs() < SAME].mean().exp())
    half = math.tan(math.radians(seen.field_of_view / 2))
    return float(round(math.degrees(2 * math.atan(half / agreed))))


def _on_the_plane(directions: Tensor) -> tuple[Tensor, Tensor]:
    """Return where azimuths and elevations, ``[P, 2]``, lie to the right of and above the middle, in focal lengths."""
    x = directions[:, 0].tan()
    return x, directions[:, 1].tan() * (1 + x**2).sqrt()


def _agree(
    photo: Sequence[Tensor], vectors: Tensor, view: tuple[Tensor, Tensor], tolerance: float
) -> tuple[float, float]:
    """Return the share of points that agree on a rotation, and how far right of a view's middle a photo's is, degrees.

    Of the photo there are directions by each focal length that is tried; of the view what `view_points` returns.
    """
    first, seen = _matched(vectors, view)
    count, yaw = max((_agreeing(seen - shown[first], tolerance) for shown in photo), key=itemgetter(0))
    return count / max(MATCHES[0], len(first)), yaw


def _matched(vectors: Tensor, view: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
    """Return the clearest matches with a view: indices of the vectors, ``[M]``, and directions there, ``[M, 2]``."""
    directions, of_view = view
    if not len(directions):
        return torch.empty(0, dtype=torch.int64), directions
    alike = vectors @ of_view.T
    first, second = mutual(alike, ALIKE)
    clearest = alike[first, second].topk(min(MATCHES[1], len(first))).indices
    return first[clearest], directions[second[clearest]]


def _agreeing(turned: Tensor, tolerance: float) -> tuple[float, float]:
    """Return how many points moved alike, of azimuths and elevations, ``[M, 2]``, and by which azimuth, degrees."""
    if not len(turned):
        return 0.0, 0.0
    together = torch.cdist(turned, turned, p=torch.inf) < tolerance
    count, middle = together.sum(1).max(0)
    return float(count), float(torch.rad2deg(turned[together[middle], 0].mean()))


def _log_odds(share: float, even: float) -> float:
    return max(LEAST, WEIGHT * math.log(share / even)) if share else LEAST


def _points(picture: NDArray[np.uint8], unit: float) -> tuple[Tensor, Tensor]:
    """Return where points are, to the right of and above the middle, in ``unit`` pixels, and their vectors."""
    positions, vectors = xfeat()(picture)
    height, width = picture.shape[:2]
    aside = torch.from_numpy(positions - np.array([width, height], np.float32) / 2) / unit
    return aside * torch.tensor([1.0, -1.0]), torch.from_numpy(vectors)


def _resized(picture: NDArray[np.uint8], factor: float) -> NDArray[np.uint8]:
    height, width = (max(1, round(side * factor)) for side in picture.shape[:2])
    return np.asarray(Image.fromarray(picture).resize((width, height), Image.Resampling.BICUBIC))
