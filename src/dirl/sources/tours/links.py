"""The links of a tour as moves: which heading of a panorama shows which link, and which panoramas stay connected."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from dirl.scenes.graph import AHEAD, BACK, IntArray, turns_only
from dirl.sources.tours.alignment import wrap
from dirl.sources.tours.tour import Tour

Array = NDArray[np.float64]

ASIDE = 90.0
"""Degrees that a link may lie aside of the heading that shows it; a move along it would lead backwards beyond."""

FAR = 45.0
"""Degrees aside that a user should know of."""

FORBIDDEN = 1e6
"""What a heading too far aside costs: more than all others of a panorama together."""


def link_ends(tour: Tour) -> tuple[IntArray, Array]:
    """Start and end of every link, int64 ``[L, 2]``, and its yaw, degrees, float64 ``[L]``."""
    yaws = tour.yaws()
    return np.array(list(yaws), np.int64).reshape(-1, 2), np.array(list(yaws.values()), float)


def follow_links(tour: Tour, along: Array, facing: Array, tolerance: float | None) -> tuple[IntArray, Array]:
    """The moves of a tour of P panoramas with K headings each.

    Two links may be nearest to the same heading, where two doors are side by side. So that none is hidden, headings are
    assigned to links by the least sum of squared angles. A heading that is left follows the link nearest to it, within
    half a turn.

    Args:
        tour: with L links.
        along: where each link is on the map, degrees clockwise, float64 ``[L]``.
        facing: the headings, degrees clockwise, float64 ``[K]``.
        tolerance: degrees between a heading and the link that a move follows; `ASIDE` if left out.

    Returns:
        Next states, int64 ``[P * K, 4]``; and how far each link lies aside of the nearest heading that shows it,
        degrees, float64 ``[L]``, infinite where none does.
    """
    ends, _ = link_ends(tour)
    count = len(facing)
    graph = turns_only(len(tour.panoramas), count)
    aside = np.full(len(ends), np.inf)
    headings = np.arange(count)
    for panorama in range(len(tour.panoramas)):
        mine = np.flatnonzero(ends[:, 0] == panorama)
        if not len(mine):
            continue
        off = np.abs(wrap(along[mine][None] - facing[:, None])).round(6)
        link = _assigned(off, 180 / count, tolerance)
        follows = headings[link >= 0]
        target = count * ends[mine[link[follows]], 1]
        graph[count * panorama + follows, AHEAD] = target + follows
        behind = (follows + count // 2) % count
        graph[count * panorama + behind, BACK] = target + behind
        np.minimum.at(aside, mine[link[follows]], off[follows, link[follows]])
    return graph, aside


def _assigned(off: Array, half: float, tolerance: float | None) -> IntArray:
    """The link of each heading, int64 ``[K]``, -1 for none; of angles between them, degrees, float64 ``[K, L]``."""
    most = ASIDE if tolerance is None else tolerance
    near = half if tolerance is None else tolerance
    link = np.where(off.min(1) <= near + 1e-6, off.argmin(1), -1)
    headings, links = linear_sum_assignment(np.where(off <= most + 1e-6, off**2, FORBIDDEN))
    within = off[headings, links] <= most + 1e-6
    link[headings[within]] = links[within]
    return link


def about_links(tour: Tour, aside: Array) -> Iterator[str]:
    """What became of the links (``aside`` is that of `follow_links`), a line each, and which panoramas are lost."""
    ids = [panorama.id for panorama in tour.panoramas]
    ends, _ = link_ends(tour)
    hidden, far = np.flatnonzero(np.isinf(aside)), np.flatnonzero(np.isfinite(aside) & (aside > FAR))
    if len(hidden):
        i, j = ends[hidden[0]]
        yield f"{len(hidden)} of {len(ends)} links are shown by no heading, the first: '{ids[i]}' to '{ids[j]}'"
    if len(far):
        i, j = ends[far[aside[far].argmax()]]
        yield (
            f"{len(far)} of {len(ends)} links are shown more than {FAR:.0f} degrees aside, because nearer headings "
            f"show others, the worst: '{ids[i]}' to '{ids[j]}', {aside[far].max():.0f} degrees"
        )
    kept = _together(len(ids), ends[np.isfinite(aside)])
    lost = [name for name, here in zip(ids, kept, strict=True) if not here]
    if lost:
        by_links = sum(_together(len(ids), ends))
        yield (
            f"{len(ids) - len(lost)} of {len(ids)} panoramas can be reached from each other ({by_links} by all links); "
            f"not among them: {', '.join(repr(name) for name in lost)}"
        )


def _together(count: int, ends: IntArray) -> NDArray[np.bool_]:
    """Which of so many panoramas are in the largest group that can be reached from each other, bool ``[P]``."""
    links = csr_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count))
    group = connected_components(links, directed=True, connection="strong")[1]
    return np.asarray(group == np.bincount(group).argmax())
