"""What recognises a place: the interface of the component group ``recogniser``, and the paper's choice."""

import math
from typing import NamedTuple, Protocol, Self, runtime_checkable

import torch
import torch.nn.functional as F
from torch import Tensor, nn


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
        """The recogniser for a place.

        Args:
            features: pooled ones of N views of the place, float ``[N, D]``.
            patches: of the same views, float ``[N, cells, channels]``.
        """

    def describe(self, features: Tensor, patches: Tensor | None = None) -> Tensor:
        """What is compared of views.

        Args:
            features: pooled ones, float ``[..., D]``.
            patches: of the same views, float ``[..., cells, channels]``.

        Returns:
            float32 ``[..., F]``.
        """

    def scores(self, seen: Tensor, references: Tensor) -> Tensor:
        """How much each visit looks like each reference.

        Args:
            seen: described views of visits, float32 ``[..., A, 4, F]``.
            references: of visits, ``[..., B, 4, F]``, or of single photos, ``[..., B, 1, F]``.

        Returns:
            float32 ``[..., A, B]``; higher is more alike.
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
    """Normalised cross-correlation of the pooled features of all views together (paper section 3.4, equation 13)."""

    reads_patches = False
    calibrated = False
    thresholds: Thresholds | None = None

    def __init__(self) -> None:
        super().__init__()

    def fit(self, features: Tensor, patches: Tensor | None = None) -> Self:
        """Itself: it has no statistics."""
        return self

    def describe(self, features: Tensor, patches: Tensor | None = None) -> Tensor:
        """The features themselves; see `Recogniser.describe`."""
        return features.float()

    def scores(self, seen: Tensor, references: Tensor) -> Tensor:
        """Pearson's coefficients, in [-1, 1], of as many views as the references have; see `Recogniser.scores`."""
        seen = seen[..., : references.shape[-2], :]
        return normal_vectors(seen.flatten(-2)) @ normal_vectors(references.flatten(-2)).transpose(-1, -2)


def ncc(observation: Tensor, goal: Tensor) -> Tensor:
    """Normalised cross-correlation of feature vectors, i.e. Pearson's coefficient (paper equation 13).

    Of float ``[..., D]``, broadcast, to ``[...]`` in [-1, 1]; 0 where one of the vectors is constant.
    """
    return (normal_vectors(observation) * normal_vectors(goal)).sum(-1)


def normal_vectors(vector: Tensor) -> Tensor:
    """Vectors, float ``[..., D]``, without their mean and of length one; the product of two is their `ncc`."""
    centred = vector - vector.mean(-1, keepdim=True)
    # The mean of a constant vector is rounded; the remainder must not be normalised to length one.
    constant = vector.amax(-1, keepdim=True) == vector.amin(-1, keepdim=True)
    return F.normalize(centred.masked_fill(constant, 0.0), dim=-1)


def in_blocks(recogniser: Recogniser, seen: Tensor, references: Tensor, block: int = 256) -> Tensor:
    """`Recogniser.scores` of many visits, ``[A, V, F]`` and ``[B, V, F]``, computed ``block`` rows at a time."""
    return torch.cat([recogniser.scores(rows, references) for rows in seen.split(block)])
