"""The headings of the panoramas of a tour, from the yaws of its links and from what the panoramas show.

Where the link from i to j stands at yaw a of image i and the link back at yaw b of image j, the headings of both
images differ by a - b - 180 degrees. Where b is not known, or links contradict each other, what the two panoramas show
tells the same (`dirl.sources.tours.rotation`). Over a graph with loops these equations are overdetermined. They are
solved by least squares, reweighted so that wrong ones lose weight (Geman and McClure's function, its width shrinking).
The beginning are headings along a spanning tree of the equations whose short loops close best.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from dirl.sources.tours.rotation import Seen
from dirl.sources.tours.tour import Tour

WIDTHS = (40.0, 25.0, 15.0, 10.0)
"""Degrees at which the weight of an equation falls to a quarter, one round after the other."""

LOOPS, REACHED = 3, 200
"""Loops, without common equations, that are tried for each equation, and panoramas around it that they may visit."""

REJECTED = 20.0
"""Degrees off from which on an equation is left out of the solution."""

LEAD = 0.5
"""Least `Seen.lead`: with less, what two panoramas show is not used."""

LEAST_PEAK = 0.1
"""Floor of `Seen.peak`: below it a pair counts no less, since it may be all that joins two parts."""

LINKS_OFF, SEEN_OFF = 1.0, 3.0
"""Degrees that links are off at least, where panoramas are compared, and that turns by what panoramas show are off."""

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Alignment:
    """Headings, and how far they can be trusted. P panoramas.

    Args:
        headings: where the middle of each image looks, degrees clockwise, float64 ``[P]``; those of one part share an
            unknown zero.
        part: which part each panorama is in, int64 ``[P]``, 0 is the largest; parts are joined by links both ways, or
            by what panoramas show.
        loops: how far off each independent loop of links both ways closes, degrees, float64 ``[L]``; rejected links
            included. What panoramas show takes the place of their links.
        rejected: panoramas of the links that were left out, and how many degrees off they are, worst first.
        one_way: links without one back, as pairs of panoramas.
    """

    headings: Array
    part: Integers
    loops: Array
    rejected: list[tuple[int, int, float]]
    one_way: list[tuple[int, int]]


def align(tour: Tour, seen: Mapping[tuple[int, int], Seen] | None = None) -> Alignment:
    """Return the headings that agree best with a tour's links, and with what pairs of its panoramas show.

    What they show is given by their places in the tour.
    """
    count = len(tour.panoramas)
    yaw = tour.yaws()
    both = [pair for pair in yaw if pair[0] < pair[1] and pair[::-1] in yaw]
    shown = {pair: turned for pair, turned in (seen or {}).items() if turned.lead >= LEAD}
    ends = np.array([*both, *shown], np.int64).reshape(-1, 2)
    turns = np.array([*(yaw[i, j] - yaw[j, i] - 180 for i, j in both), *(turned.turn for turned in shown.values())])
    by_link = np.arange(len(ends)) < len(both)
    trust = np.ones(len(ends))
    if shown:
        loops = align(tour).loops
        links_off = max(LINKS_OFF, float(np.median(loops))) if len(loops) else SEEN_OFF
        seen_off = [SEEN_OFF / np.clip(min(turned.lead, turned.peak), LEAST_PEAK, 1) for turned in shown.values()]
        trust = (LINKS_OFF / np.array([*[links_off] * len(both), *seen_off])) ** 2
    headings = _solved(ends, turns, trust, count)
    off = np.abs(_off(ends, turns, headings))
    kept = off <= REJECTED
    part = _forest(ends[kept], turns[kept], count)[1]
    headings = _relaxed(ends[kept], turns[kept], headings, trust[kept], part)
    closing = ~by_link | np.array([pair not in shown for pair in [*both, *shown]], bool)
    worst = sorted(np.flatnonzero(~kept & by_link).tolist(), key=lambda equation: -off[equation])
    return Alignment(
        headings % 360,
        part,
        _loops(ends[closing], turns[closing], kept[closing], count),
        [(*both[equation], float(off[equation])) for equation in worst],
        [pair for pair in yaw if pair[::-1] not in yaw],
    )


def wrap(degrees: Array) -> Array:
    """Return angles from -180 to below 180 degrees."""
    return (degrees + 180) % 360 - 180


def least_squares(ends: Integers, offsets: Array, weight: Array, part: Integers) -> Array:
    """Return values, float64 ``[N, ...]``, that differ by offsets as nearly as possible, 0 for the first of each part.

    Args:
        ends: pairs of values, int64 ``[E, 2]``.
        offsets: by how much the second is larger, float64 ``[E, ...]``.
        weight: of each, float64 ``[E]``.
        part: which values are joined by pairs, int64 ``[N]``.
    """
    count = len(part)
    matrix, right = np.zeros((count, count)), np.zeros((count, *offsets.shape[1:]))
    for end, other, sign in ((1, 0, 1), (0, 1, -1)):
        np.add.at(matrix, (ends[:, end], ends[:, end]), weight)
        np.add.at(matrix, (ends[:, end], ends[:, other]), -weight)
        np.add.at(right, ends[:, end], sign * (offsets.T * weight).T)
    first = np.unique(part, return_index=True)[1]
    matrix[first, first] += 1
    return np.asarray(np.linalg.solve(matrix, right))


def _off(ends: Integers, turns: Array, headings: Array) -> Array:
    """Return how much larger each turn is than the difference of the headings, degrees."""
    return wrap(turns - headings[ends[:, 1]] + headings[ends[:, 0]])


def _relaxed(ends: Integers, turns: Array, headings: Array, weight: Array, part: Integers) -> Array:
    """Take one step of Gauss and Newton, exact where no turn wraps around; the first heading of each part stays."""
    return headings + least_squares(ends, _off(ends, turns, headings), weight, part)


def _solved(ends: Integers, turns: Array, trust: Array, count: int) -> Array:
    """Return headings that most equations agree with: along a tree of those whose loops close best, then reweighted.

    All equations of a lone loop close it equally well, so that the one trusted least is left out of the tree.
    """
    errors = _loop_errors(ends, turns, count) / np.sqrt(trust)
    rank = np.argsort(np.argsort(errors, kind="stable"))
    headings, part, _ = _forest(ends, turns, count, rank)
    for width in WIDTHS:
        for _ in range(2):
            weight = 1 / (1 + (_off(ends, turns, headings) / width) ** 2) ** 2
            headings = _relaxed(ends, turns, headings, weight * trust, part)
    return headings


def _loop_errors(ends: Integers, turns: Array, count: int) -> Array:
    """Return the error of the best of few short loops through each equation, degrees, float64 ``[E]``; 180 without."""
    # The neighbours of each panorama, the equation with each, and 1 if it is to be added, -1 if subtracted.
    near: list[list[tuple[int, int, int]]] = [[] for _ in range(count)]
    for equation, (i, j) in enumerate(ends.tolist()):
        near[i].append((j, equation, 1))
        near[j].append((i, equation, -1))
    errors = np.full(len(ends), 180.0)
    for index, (i, j) in enumerate(ends.tolist()):
        used = {index}
        for _ in range(LOOPS):
            path = _short_path(i, j, near, used)
            if path is None:
                break
            used |= {equation for equation, _ in path}
            off = turns[index] - sum(sign * turns[equation] for equation, sign in path)
            errors[index] = min(errors[index], abs(wrap(off)))
    return errors


def _short_path(
    start: int, end: int, near: list[list[tuple[int, int, int]]], used: Collection[int]
) -> list[tuple[int, int]] | None:
    """Return equations and their signs along a shortest path without ``used``, among `REACHED` panoramas nearby."""
    came: dict[int, tuple[int, int, int]] = {start: (-1, -1, 0)}
    queue = [start]
    for here in queue:
        if here == end or len(queue) > REACHED:
            break
        for there, equation, sign in near[here]:
            if there not in came and equation not in used:
                came[there] = (here, equation, sign)
                queue.append(there)
    if end not in came:
        return None
    path = []
    while end != start:
        end, equation, sign = came[end]
        path.append((equation, sign))
    return path


def _forest(
    ends: Integers, turns: Array, count: int, rank: Integers | None = None
) -> tuple[Array, Integers, NDArray[np.bool_]]:
    """Return a spanning forest with the equations of lowest rank; without ranks the nearest panoramas come first.

    Returns the headings along it, from 0 at the first panorama of each part; the part of each panorama, the largest
    first; and which equations it takes.
    """
    graph = nx.Graph()
    graph.add_nodes_from(range(count))
    for equation in np.argsort(rank).tolist() if rank is not None else range(len(ends)):
        if not graph.has_edge(*ends[equation].tolist()):
            graph.add_edge(*ends[equation].tolist(), equation=equation, rank=0 if rank is None else rank[equation])
    if rank is not None:
        graph = nx.minimum_spanning_tree(graph, "rank")
    headings, part, used = np.zeros(count), np.zeros(count, np.int64), np.zeros(len(ends), bool)
    for number, here in enumerate(nx.connected_components(graph)):
        part[list(here)] = number
        for near, far in nx.bfs_edges(graph, min(here)):
            equation = graph.edges[near, far]["equation"]
            headings[far] = headings[near] + (turns[equation] if ends[equation, 0] == near else -turns[equation])
            used[equation] = True
    order = np.argsort(np.argsort(-np.bincount(part), kind="stable"))
    return headings, order[part], used


def _loops(ends: Integers, turns: Array, kept: NDArray[np.bool_], count: int) -> Array:
    """Return how far off loops close, degrees, float64 ``[L]``, one for each equation that is not in a forest."""
    headings, part, used = _forest(ends[kept], turns[kept], count)
    closing = part[ends[:, 0]] == part[ends[:, 1]]
    closing[np.flatnonzero(kept)[used]] = False
    return np.abs(_off(ends, turns, headings))[closing]
