"""The links of a tour as moves: which heading of a panorama shows which link, and which panoramas stay connected."""

from collections.abc import Iterator

import networkx as nx
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import block_array, csr_array, eye_array
from scipy.sparse.csgraph import connected_components, reverse_cuthill_mckee

from dirl.scenes.graph import AHEAD, BACK, IntArray, turns_only
from dirl.sources.tours.alignment import wrap
from dirl.sources.tours.tour import Tour

Array = NDArray[np.float64]

ASIDE = 90.0
"""Degrees that a link may lie aside of the heading that shows it; a move along it would lead backwards beyond."""

FAR = 45.0
"""Degrees aside that a user should know of."""

SHOWN, BRIDGE, UNDONE, MISLEADING = 20.0, 60.0, 4.0, 2.0
"""What it is worth to show a link, one without which panoramas fall apart, that a move back undoes a move along it, and
that none seems to where a link leads one way; a link 90 degrees aside costs 1."""

TOGETHER = 60
"""Panoramas that are solved as one program, nearly always in less than a second; of more, neighbours are together."""

SECONDS = 60.0
"""After which the best assignment so far is taken, of panoramas with several times as many links as headings."""


def link_ends(tour: Tour) -> tuple[IntArray, Array]:
    """Start and end of every link, int64 ``[L, 2]``, and its yaw, degrees, float64 ``[L]``."""
    yaws = tour.yaws()
    return np.array(list(yaws), np.int64).reshape(-1, 2), np.array(list(yaws.values()), float)


def follow_links(tour: Tour, along: Array, facing: Array, tolerance: float = ASIDE) -> tuple[IntArray, Array]:
    """Return the moves of a tour of P panoramas with K headings each.

    Every link gets one heading of its panorama, and a link both ways opposite ones at its two ends, see
    `assign_headings`. A move ahead follows the link of the heading, and a move back that of the opposite heading. Both
    keep the heading, so that a move back undoes a move ahead.

    Args:
        tour: with L links.
        along: where each link is on the map, degrees clockwise, float64 ``[L]``.
        facing: the headings, degrees clockwise, float64 ``[K]``.
        tolerance: degrees between a link and its heading, at most.

    Returns:
        Next states, int64 ``[P * K, 4]``; and how far each link lies aside of its heading, degrees, float64 ``[L]``,
        infinite for links without one.
    """
    ends, _ = link_ends(tour)
    count = len(facing)
    off = np.abs(wrap(along[:, None] - facing)).round(6)
    heading = assign_headings(ends, np.where(off <= tolerance + 1e-6, off, np.inf))
    shown = np.flatnonzero(heading >= 0)
    ahead = heading[shown]
    behind = (ahead + count // 2) % count
    start, end = count * ends[shown].T
    graph = turns_only(len(tour.panoramas), count)
    graph[start + ahead, AHEAD] = end + ahead
    graph[start + behind, BACK] = end + behind
    aside = np.full(len(ends), np.inf)
    aside[shown] = off[shown, ahead]
    return graph, aside


def assign_headings(ends: IntArray, off: Array) -> IntArray:
    """Return the heading of each link, int64 ``[L]``, -1 for none.

    Panoramas are not assigned one by one, because the heading of a link both ways at one end decides that at the other.
    As many links as possible are shown, as many of those both ways as possible at opposite headings, and then the sum
    of squared angles is least. Large tours are solved in parts of neighbours, one after the other.

    Args:
        ends: the panoramas where each link starts and ends, int64 ``[L, 2]``.
        off: degrees between each link and each heading, float64 ``[L, K]``, infinite where it must not have it.
    """
    assigned = np.full(len(ends), -1)
    joined = csr_array((np.ones(len(ends)), ends.T), shape=(ends.max() + 1,) * 2)
    rank = np.argsort(reverse_cuthill_mckee((joined + joined.T).tocsr(), symmetric_mode=True))
    part = rank[ends].min(1) // TOGETHER
    bridges = {frozenset(bridge) for bridge in nx.bridges(nx.Graph(ends.tolist()))}
    worth = np.array([BRIDGE if frozenset(pair) in bridges else SHOWN for pair in ends.tolist()])
    free = off.copy()
    for number in np.unique(part):
        mine = np.flatnonzero(part == number)
        assigned[mine] = _solve(ends[mine], free[mine], worth[mine])
        shown = mine[assigned[mine] >= 0]
        for start, heading in zip(ends[shown, 0], assigned[shown], strict=True):
            free[ends[:, 0] == start, heading] = np.inf
    return assigned


def _solve(ends: IntArray, off: Array, worth: Array) -> IntArray:
    """Return the heading of each link as `assign_headings` does, by a set packing as a mixed-integer linear program.

    A choice is a link at a heading, or a link both ways at two opposite headings. No link and no heading of a panorama
    may be in two of the choices that are taken. Further variables say which links one way have another link behind.
    """
    links, count = off.shape
    number = {(start, end): link for link, (start, end) in enumerate(ends.tolist())}
    back = np.array([number.get((end, start), -1) for start, end in ends.tolist()])
    slot = links + count * ends[:, :1] + np.arange(count)  # a panorama's heading, numbered after the links
    cost = (off / ASIDE) ** 2

    link, heading = np.nonzero(np.isfinite(off))
    there = np.flatnonzero(back > np.arange(links))
    opposite = (np.arange(count) + count // 2) % count
    cost_both = cost[there] + cost[back[there]][:, opposite]
    pair, heading_there = np.nonzero(np.isfinite(cost_both))
    link_there, link_back, heading_back = there[pair], back[there[pair]], opposite[heading_there]

    # What each choice takes: a link and a heading, or two of each.
    alone = np.arange(len(link))
    both = len(link) + np.arange(len(pair))
    choice = np.concatenate([alone, alone, both, both, both, both])
    slots_both = slot[link_there, heading_there], slot[link_back, heading_back]
    taken = np.concatenate([link, slot[link, heading], link_there, link_back, *slots_both])
    worth_alone = worth[link] - cost[link, heading]
    worth_both = worth[link_there] + worth[link_back] + 2 * UNDONE - cost_both[pair, heading_there]
    value = np.concatenate([worth_alone, worth_both])
    assigned = np.full(links, -1)
    if not len(value):
        return assigned
    uses = csr_array((np.ones(len(choice)), (taken, choice)), shape=(links + count * (ends.max() + 1), len(value)))
    # What lies behind who came by a link one way would seem to lead back. Where a link must lie there, it costs.
    one_way = np.flatnonzero(back[link] < 0)
    misleads = np.arange(len(one_way))
    behind = uses[links + count * ends[link[one_way], 1] + opposite[heading[one_way]]]
    came = csr_array((np.ones(len(one_way)), (misleads, one_way)), shape=behind.shape)
    takes = block_array([[uses, None], [came + behind, -eye_array(len(one_way))]], format="csr")
    value = np.concatenate([value, np.full(len(one_way), -MISLEADING)])
    solution = milp(
        -value,
        constraints=LinearConstraint(takes, ub=1),
        integrality=np.ones(len(value)),
        bounds=Bounds(0, 1),
        options={"time_limit": SECONDS},
    )
    chosen = solution.x > 0.5
    assigned[link[chosen[alone]]] = heading[chosen[alone]]
    assigned[link_there[chosen[both]]] = heading_there[chosen[both]]
    assigned[link_back[chosen[both]]] = heading_back[chosen[both]]
    return assigned


def about_links(tour: Tour, graph: IntArray, aside: Array) -> Iterator[str]:
    """Yield what became of the links (see `follow_links`), a line each, and which panoramas are lost."""
    ids = [panorama.id for panorama in tour.panoramas]
    ends, _ = link_ends(tour)
    count = len(graph) // len(ids)
    state = np.flatnonzero(graph[:, AHEAD] >= 0)
    there = graph[state, AHEAD]
    links = set(map(tuple, ends.tolist()))
    both = np.array([pair[::-1] in links for pair in zip(state // count, there // count, strict=True)], bool)
    undone = graph[there[both], BACK] == state[both]
    if both.any():
        share = f"{undone.sum()} of {len(undone)} moves ahead along links both ways"
        yield f"a move back undoes {share} ({undone.mean():.2f})"
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
    """Return which of so many panoramas are in the largest group that can be reached from each other, bool ``[P]``."""
    links = csr_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count))
    group = connected_components(links, directed=True, connection="strong")[1]
    return np.asarray(group == np.bincount(group).argmax())
