"""From a tour to a scene: aligned headings, a map, and moves along links, each shown by a heading of its own."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import networkx as nx
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import block_array, csr_array, eye_array
from scipy.sparse.csgraph import connected_components, reverse_cuthill_mckee
from tqdm import tqdm

from dirl.scenes.graph import AHEAD, BACK, IntArray, turns_only
from dirl.scenes.scene import Scene, SceneError, check_name
from dirl.sources.tours.alignment import LEAD, Alignment, align, least_squares, wrap
from dirl.sources.tours.rotation import Seen, columns, compare
from dirl.sources.tours.tour import Tour

Array = NDArray[np.float64]

CLOSED = 5.0
"""Degrees of error up to which the median loop closes; else all linked panoramas are compared."""

ASTRAY = tuple(range(-60, 61, 15))
"""Degrees that links may be off where loops do not close."""

ASIDE = 90.0
"""Degrees that a link may lie aside of the heading that shows it; a move along it would lead backwards beyond."""

FAR = 45.0
"""Degrees aside that a user should know of."""

STEP = 2.0
"""Metres that a link is long on the map, where the tour gives no positions."""

SHOWN, BRIDGE, UNDONE, MISLEADING = 20.0, 60.0, 4.0, 2.0
"""What it is worth to show a link, one without which panoramas fall apart, that a move back undoes a move along it, and
that none seems to where a link leads one way; a link 90 degrees aside costs 1."""

TOGETHER = 60
"""Panoramas that are solved as one program, nearly always in less than a second; of more, neighbours are together."""

SECONDS = 60.0
"""After which the best assignment so far is taken, of panoramas with several times as many links as headings."""


@dataclass(frozen=True, eq=False)
class Converted:
    """What became of a tour of P panoramas.

    Args:
        scene: K states for each panorama, in their order; without views and features.
        yaws: where the view of each state looks, degrees clockwise from the middle of its panorama, float64 ``[P, K]``.
        arrows: where the arrow is that a move ahead follows, likewise, nan where there is none, float64 ``[P, K]``.
        notes: what a user must know: what was left out, how well headings agree, what is not aligned, a line each.
        layout: whether positions are no measured ones but were laid out by the links.
    """

    scene: Scene
    yaws: Array
    arrows: Array
    notes: list[str]
    layout: bool


def tour_scene(tour: Tour, *, headings: int = 8, name: str | None = None, compare_images: bool = True) -> Converted:
    """Return the scene of a tour.

    Each link has a heading of its own, along which a move ahead leads, and a link both ways has opposite headings at
    its ends, so that a move back undoes a move ahead: see `follow_links`.

    Each panorama has so many ``headings``, a multiple of four. With ``compare_images`` those that links do not give, or
    contradict, come from what the panoramas show. The scene has the tour's name if none is given.

    Raises:
        SceneError: another number of headings, a tour without any link that a move could follow, or an image that
            cannot be read.
    """
    if headings % 4 or not 4 <= headings <= 36:
        raise SceneError(f"headings={headings}: must be a multiple of four from 4 to 36")
    # Of a title letters, digits and some signs are kept, see `check_name`.
    kept = "".join(sign if sign.isalnum() or sign in " _.,()+-" else "_" for sign in name or tour.name)
    name = kept.encode()[:100].decode(errors="ignore").strip() or "tour"
    check_name(name, tour.origin)
    turn = 360 / headings
    by_links = aligned = align(tour)
    if not any(panorama.links for panorama in tour.panoramas):
        raise SceneError(f"{tour.origin}: no panorama has a link to another one, so no move is possible")
    seen = _compared(tour, by_links) if compare_images else {}
    if seen:
        aligned = align(tour, seen)
    middles, along = _directions(tour, aligned, turn)
    facing = np.float64(_zero(along, turn)) + turn * np.arange(headings, dtype=np.float64)
    graph, off = follow_links(tour, along, facing)
    layout = any(panorama.position is None for panorama in tour.panoramas)
    places = _layout(tour, along, aligned.part) if layout else np.array([p.position for p in tour.panoramas])
    scene = Scene(
        name=name,
        graph=graph,
        positions=np.repeat(places, headings, axis=0),
        headings=np.tile(facing.round(6) % 360, len(tour.panoramas)),
        source="tour, laid out" if layout else "tour",
        extractor="none",
        origin=tour.origin,
    )
    about = _about_headings(tour, by_links, aligned, seen)
    notes = [*tour.notes, *about, *about_links(tour, graph, off)]
    if layout:
        known = sum(panorama.position is not None for panorama in tour.panoramas)
        so = f"known of {known} of {len(places)} panoramas only, so they are not used" if known else "not known"
        notes.append(f"positions are {so}: the map is a layout in which each link is {STEP:g} m long")
    links, arrows = tour.yaws(), np.full(len(graph), np.nan)
    for state in np.flatnonzero(graph[:, AHEAD] >= 0).tolist():
        arrows[state] = links[state // headings, int(graph[state, AHEAD]) // headings]
    return Converted(scene, wrap(facing - middles[:, None]), arrows.reshape(-1, headings), notes, layout)


def _directions(tour: Tour, aligned: Alignment, turn: float) -> tuple[Array, Array]:
    """Return where the middle of each panorama and each link look on the map, degrees clockwise.

    The zero of each part is the one of its stated headings that agrees best with the others; where none is stated, the
    one that has most links along a heading of the agent.
    """
    ends, yaws = link_ends(tour)
    known, stated = _stated(tour)
    middles = aligned.headings.copy()
    for part in range(int(aligned.part.max()) + 1):
        here = np.flatnonzero(aligned.part == part)
        mine = np.isin(known, here)
        if mine.any():
            off = stated[mine] - middles[known[mine]]
            middles[here] += off[np.abs(wrap(off[:, None] - off)).sum(1).round(6).argmin()]
        else:
            middles[here] -= _zero((middles[ends[:, 0]] + yaws)[np.isin(ends[:, 0], here)], turn)
    return middles % 360, (middles[ends[:, 0]] + yaws) % 360


def _stated(tour: Tour) -> tuple[IntArray, Array]:
    """Return the panoramas that state headings, int64 ``[H]``, and the headings, degrees, float64 ``[H]``."""
    stated = [(index, place.heading) for index, place in enumerate(tour.panoramas) if place.heading is not None]
    return np.array([index for index, _ in stated], np.int64), np.array([heading for _, heading in stated], np.float64)


def _zero(along: Array, turn: float) -> float:
    """Return the offset of headings, half a turn at most, that has links along them: a circular mean."""
    if not len(along):
        return 0.0
    mean = np.exp(1j * np.radians(along) * 360 / turn).mean()
    return float(np.degrees(np.angle(mean)) * turn / 360) if abs(mean) > 1e-9 else 0.0


def _layout(tour: Tour, along: Array, part: IntArray) -> Array:
    """Return positions ``[P, 2]`` at which links are a step long in their directions, or nearly; parts side by side."""
    ends, _ = link_ends(tour)
    ends, along = ends[part[ends[:, 0]] == part[ends[:, 1]]], along[part[ends[:, 0]] == part[ends[:, 1]]]
    way = STEP * np.stack([np.sin(np.radians(along)), np.cos(np.radians(along))], 1)
    places = least_squares(ends, way, np.ones(len(ends)), part)
    edge = 0.0
    for index in range(int(part.max()) + 1):
        here = part == index
        places[here] -= places[here].min(0) - [edge, 0]
        edge = places[here, 0].max() + 2 * STEP
    return places


def _compared(tour: Tour, aligned: Alignment) -> dict[tuple[int, int], Seen]:
    """Compare panoramas at links that do not give their headings, or at all links if loops do not close."""
    links = tour.yaws()
    open_ = len(aligned.loops) > 0 and np.median(aligned.loops) > CLOSED
    doubtful = {*aligned.one_way, *(pair[:2] for pair in aligned.rejected)}
    chosen = [pair for pair in links if (open_ and (pair[0] < pair[1] or pair[::-1] not in links)) or pair in doubtful]
    shown = {index: columns(tour.panoramas[index].image) for index in sorted({end for pair in chosen for end in pair})}
    aside = ASTRAY if open_ else (0.0,)
    return {
        (i, j): compare(shown[i], shown[j], [links[i, j] + off for off in aside])
        for i, j in tqdm(chosen, desc="compared", disable=None if chosen else True)
    }


def _about_headings(
    tour: Tour, by_links: Alignment, aligned: Alignment, seen: Mapping[tuple[int, int], Seen]
) -> Iterator[str]:
    """Yield the notes on how well headings agree, by links alone and by what panoramas show."""

    def closing(loops: Array) -> str:
        return f"close with a median error of {np.median(loops):.1f} degrees, at most {loops.max():.1f}"

    ids = [panorama.id for panorama in tour.panoramas]
    if len(by_links.loops):
        yield f"headings: {len(by_links.loops)} loops of links {closing(by_links.loops)}"
    if seen:
        clear = sum(pair.lead >= LEAD for pair in seen.values())
        after = f"; with that {len(aligned.loops)} loops {closing(aligned.loops)}" if len(aligned.loops) else ""
        yield f"{clear} of {len(seen)} pairs of panoramas that were compared show how they are turned{after}"
    if not len(aligned.loops):
        yield "no links form a loop: nothing checks the headings"
    if aligned.rejected:
        i, j, off = aligned.rejected[0]
        yield (
            f"{len(aligned.rejected)} links both ways contradict the others and were not used to align headings, the "
            f"worst: '{ids[i]}' and '{ids[j]}', {off:.0f} degrees off"
        )
    known = set(aligned.part[_stated(tour)[0]].tolist())
    others = range(1, int(aligned.part.max()) + 1)
    for use, chosen in (
        ("their stated headings are used", [part for part in others if {0, part} <= known]),
        ("their headings cannot be aligned with the others'", [part for part in others if not {0, part} <= known]),
    ):
        if chosen:
            names = ", ".join(f"'{ids[index]}'" for index in np.flatnonzero(np.isin(aligned.part, chosen)))
            yield f"{len(chosen)} parts are not joined with the others by links both ways; {use}: {names}"
    if aligned.one_way:
        i, j = aligned.one_way[0]
        yield f"{len(aligned.one_way)} links lead one way only, the first: '{ids[i]}' to '{ids[j]}'"


def link_ends(tour: Tour) -> tuple[IntArray, Array]:
    """Return start and end of every link, int64 ``[L, 2]``, and its yaw, degrees, float64 ``[L]``."""
    yaws = tour.yaws()
    return np.array(list(yaws), np.int64).reshape(-1, 2), np.array(list(yaws.values()), float)


def follow_links(tour: Tour, along: Array, facing: Array) -> tuple[IntArray, Array]:
    """Return the moves of a tour of P panoramas with K headings each.

    Every link gets one heading of its panorama, and a link both ways opposite ones at its two ends, see
    `assign_headings`. A move ahead follows the link of the heading, and a move back that of the opposite heading. Both
    keep the heading, so that a move back undoes a move ahead.

    Args:
        tour: with L links.
        along: where each link is on the map, degrees clockwise, float64 ``[L]``.
        facing: the headings, degrees clockwise, float64 ``[K]``.

    Returns:
        Next states, int64 ``[P * K, 4]``; and how far each link lies aside of its heading, degrees, float64 ``[L]``,
        infinite for links without one.
    """
    ends, _ = link_ends(tour)
    count = len(facing)
    off = np.abs(wrap(along[:, None] - facing)).round(6)
    heading = assign_headings(ends, np.where(off <= ASIDE, off, np.inf))
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
