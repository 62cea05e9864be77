"""The headings of the panoramas of a tour, from the yaws of links that go both ways.

Where the link from i to j stands at yaw a of image i and the link back at yaw b of image j, the headings of both
images differ by a - b - 180 degrees. Over a graph with loops these equations are overdetermined. They are solved by
least squares, reweighted so that wrong links lose weight (Geman and McClure's function, its width shrinking). The
beginning are headings along a spanning tree of the links whose short loops close best.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dirl.tours.tour import Tour

WIDTHS = (40.0, 25.0, 15.0, 10.0)
"""Degrees at which the weight of a link falls to a quarter, one round after the other."""

LOOPS, REACHED = 3, 200
"""Of each link so many loops without common links are tried, among so many panoramas around it."""

REJECTED = 20.0
"""Degrees off from which on a link is left out of the solution."""

Array = NDArray[np.float64]
Edges = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Alignment:
    """Headings, and how far they can be trusted. P panoramas.

    Args:
        headings: where the middle of each image looks, degrees clockwise, float64 ``[P]``; those of one part share an
            unknown zero.
        part: which part each panorama is in, int64 ``[P]``, 0 is the largest; parts are joined by links both ways.
        loops: how far off each independent loop of links closes, degrees, float64 ``[L]``; rejected links included.
        rejected: panoramas of the links that were left out, and how many degrees off they are, worst first.
        unchecked: panoramas on no loop: their headings are as good as one pair of yaws.
        one_way: links without one back, as pairs of panoramas.
    """

    headings: Array
    part: NDArray[np.int64]
    loops: Array
    rejected: list[tuple[int, int, float]]
    unchecked: list[int]
    one_way: list[tuple[int, int]]


def align(tour: Tour) -> Alignment:
    """The headings that agree best with a tour's links."""
    count = len(tour.panoramas)
    number = {panorama.id: index for index, panorama in enumerate(tour.panoramas)}
    yaw = {
        (index, number[link.target]): link.yaw
        for index, panorama in enumerate(tour.panoramas)
        for link in panorama.links
    }
    both = [pair for pair in yaw if pair[0] < pair[1] and pair[::-1] in yaw]
    edges = np.array(both, np.int64).reshape(-1, 2)
    turns = np.array([yaw[i, j] - yaw[j, i] - 180 for i, j in both])
    headings = _solved(edges, turns, count)
    off = np.abs(wrap(turns - headings[edges[:, 1]] + headings[edges[:, 0]]))
    kept = off <= REJECTED
    parents, part = _forest(edges[kept], count)
    headings = _least_squares(edges[kept], turns[kept], headings, np.ones(kept.sum()), _pins(part))
    loops, on_loop = _loops(edges, turns, parents)
    worst = sorted(np.flatnonzero(~kept).tolist(), key=lambda edge: -off[edge])
    return Alignment(
        headings % 360,
        part,
        loops,
        [(*both[edge], float(off[edge])) for edge in worst],
        [index for index in range(count) if index not in on_loop],
        [pair for pair in yaw if pair[::-1] not in yaw],
    )


def wrap(degrees: Array) -> Array:
    """Angles from -180 to below 180 degrees."""
    return (degrees + 180) % 360 - 180


def _solved(edges: Edges, turns: Array, count: int) -> Array:
    """Headings that most links agree with: along a tree of links whose loops close best, then reweighted."""
    order = np.argsort(_loop_errors(edges, turns, count), kind="stable")
    tree = _tree(edges[order], count)
    headings = _propagated(edges[order][tree], turns[order][tree], count)
    _, part = _forest(edges, count)
    for width in WIDTHS:
        for _ in range(2):
            off = wrap(turns - headings[edges[:, 1]] + headings[edges[:, 0]])
            weight = 1 / (1 + (off / width) ** 2) ** 2
            headings = _least_squares(edges, turns, headings, weight, _pins(part))
    return headings


def _loop_errors(edges: Edges, turns: Array, count: int) -> Array:
    """How far off the best of a few short loops through each link closes, degrees, float64 ``[E]``; 180 without any."""
    turn = _both_ways(edges, turns)
    near = _neighbours(edges, count)
    errors = np.full(len(edges), 180.0)
    for index, (i, j) in enumerate(edges.tolist()):
        used = {(i, j), (j, i)}
        for _ in range(LOOPS):
            path = _short_path(i, j, near, used)
            if path is None:
                break
            steps = list(pairwise(path))
            used |= {step for a, b in steps for step in ((a, b), (b, a))}
            error = abs(float(wrap(np.array(turn[i, j] - sum(turn[step] for step in steps)))))
            errors[index] = min(errors[index], error)
    return errors


def _both_ways(edges: Edges, turns: Array) -> dict[tuple[int, int], float]:
    """The turn along each link, and its opposite the other way."""
    turn = {(i, j): t for (i, j), t in zip(edges.tolist(), turns.tolist(), strict=True)}
    return turn | {(j, i): -t for (i, j), t in turn.items()}


def _neighbours(edges: Edges, count: int) -> list[list[int]]:
    near: list[list[int]] = [[] for _ in range(count)]
    for i, j in edges.tolist():
        near[i].append(j)
        near[j].append(i)
    return near


def _short_path(start: int, end: int, near: list[list[int]], used: set[tuple[int, int]]) -> list[int] | None:
    """A shortest path that takes no used step, among the nearest `REACHED` panoramas; None if there is none."""
    came = {start: -1}
    queue = [start]
    for here in queue:
        if here == end or len(queue) > REACHED:
            break
        for there in near[here]:
            if there not in came and (here, there) not in used:
                came[there] = here
                queue.append(there)
    if end not in came:
        return None
    path = [end]
    while path[-1] != start:
        path.append(came[path[-1]])
    return path[::-1]


def _tree(edges: Edges, count: int) -> list[int]:
    """The first edges that make a spanning forest (Kruskal's), by their places."""
    root = list(range(count))

    def find(one: int) -> int:
        while root[one] != one:
            root[one] = root[root[one]]
            one = root[one]
        return one

    chosen = []
    for index, (i, j) in enumerate(edges.tolist()):
        a, b = find(i), find(j)
        if a != b:
            root[a] = b
            chosen.append(index)
    return chosen


def _propagated(edges: Edges, turns: Array, count: int) -> Array:
    """Headings along a forest, from 0 at the first panorama of each part."""
    turn = _both_ways(edges, turns)
    parents, _ = _forest(edges, count)
    headings = np.zeros(count)
    for here in sorted(range(count), key=lambda one: parents[one][1]):
        before = parents[here][0]
        if before >= 0:
            headings[here] = headings[before] + turn[before, here]
    return headings


def _least_squares(edges: Edges, turns: Array, headings: Array, weight: Array, pins: NDArray[np.int64]) -> Array:
    """One step of Gauss and Newton, exact where no turn wraps around; ``pins`` keep their headings."""
    count = len(headings)
    off = wrap(turns - headings[edges[:, 1]] + headings[edges[:, 0]])
    matrix, right = np.zeros((count, count)), np.zeros(count)
    for end, other, sign in ((1, 0, 1), (0, 1, -1)):
        np.add.at(matrix, (edges[:, end], edges[:, end]), weight)
        np.add.at(matrix, (edges[:, end], edges[:, other]), -weight)
        np.add.at(right, edges[:, end], sign * weight * off)
    matrix[pins, pins] += 1
    return headings + np.linalg.solve(matrix, right)


def _pins(part: NDArray[np.int64]) -> NDArray[np.int64]:
    """The first panorama of each part."""
    return np.unique(part, return_index=True)[1]


def _forest(edges: Edges, count: int) -> tuple[list[tuple[int, int]], NDArray[np.int64]]:
    """A spanning forest, breadth first: parent (-1 = a root) and depth of each; and the parts, from the largest on."""
    near = _neighbours(edges, count)
    parents, part, parts = [(-1, -1)] * count, np.full(count, -1), 0
    for root in range(count):
        if part[root] >= 0:
            continue
        queue, parents[root], part[root] = [root], (-1, 0), parts
        for here in queue:
            for there in near[here]:
                if part[there] < 0:
                    parents[there], part[there] = (here, parents[here][1] + 1), parts
                    queue.append(there)
        parts += 1
    order = np.argsort(np.argsort(-np.bincount(part, minlength=parts), kind="stable"))
    return parents, order[part]


def _loops(edges: Edges, turns: Array, parents: Sequence[tuple[int, int]]) -> tuple[Array, set[int]]:
    """How far off the loop closes that each link makes which is not in the forest, and the panoramas on any loop."""
    turn = _both_ways(edges, turns)
    errors, on_loop = [], set()
    for (i, j), t in zip(edges.tolist(), turns.tolist(), strict=True):
        if j in (parents[i][0],) or i in (parents[j][0],):
            continue
        path = list(_path(i, j, parents))
        if path[-1] != j:
            continue  # a rejected link between two parts
        round_ = sum(turn[a, b] for a, b in pairwise(path))
        errors.append(abs(float(wrap(np.array(t - round_)))))
        on_loop |= set(path)
    return np.array(errors), on_loop


def _path(start: int, end: int, parents: Sequence[tuple[int, int]]) -> Iterator[int]:
    """The path from one panorama to another through the forest; it ends at a root if there is none."""
    back = []
    while start != end and (parents[start][0] >= 0 or parents[end][0] >= 0):
        if parents[start][1] >= parents[end][1]:
            yield start
            start = parents[start][0]
        else:
            back.append(end)
            end = parents[end][0]
    yield start
    if start == end:
        yield from reversed(back)
