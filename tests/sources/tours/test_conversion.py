"""From a tour to the graph of a scene: moves along links, headings, maps, and what a user is told."""

from dataclasses import replace
from functools import partial

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused
from tours import grid_truth, tour_of, turned

from dirl.scenes.graph import AHEAD, BACK
from dirl.sources.tours import conversion

tour_scene = partial(conversion.tour_scene, compare_images=False)  # these tours have no images


def told(made, words):
    return [note for note in made.notes if words in note]


def test_a_laid_out_map_has_the_shape_of_the_place():
    truth = turned(grid_truth(4, 3), 1.0)
    made = tour_scene(tour_of(truth), headings=8)
    assert made.layout
    assert told(made, "positions are not known: the map is a layout in which each link is 2 m long")
    places = made.scene.positions[::8]
    apart, wanted = (np.hypot(*np.moveaxis(p[:, None] - p, -1, 0)) for p in (places, truth.places))
    assert np.allclose(apart, wanted, atol=1e-6)


def test_given_positions_and_headings_are_kept():
    truth = grid_truth(2, 2, middles=[50, 20, 70, 80])  # of a grid that lies along the axes
    tour = tour_of(truth)
    known = [replace(one, position=tuple(at)) for one, at in zip(tour.panoramas, truth.places, strict=True)]
    known[1] = replace(known[1], heading=0.0)  # so that the axes are 20 degrees off
    made = tour_scene(replace(tour, panoramas=tuple(known)), headings=4)
    assert not made.layout
    assert (made.scene.positions[::4] == truth.places).all()
    assert np.allclose(made.scene.headings[:4], [340, 70, 160, 250])
    assert np.allclose(made.yaws[1] % 360, [340, 70, 160, 250])
    known[2] = replace(known[2], position=None)
    made = tour_scene(replace(tour, panoramas=tuple(known)), headings=4)
    assert made.layout
    assert told(made, "positions are known of 3 of 4 panoramas only, so they are not used: the map is a layout")


def test_a_move_back_undoes_every_move_ahead_though_panoramas_are_crowded():
    """Each at the middle of eight others, in a grid that leans by half a heading and a little more."""
    rng, truth = np.random.default_rng(0), grid_truth(4, 4)
    near = [(i, j) for i in range(16) for j in range(16) if 0 < np.hypot(*(truth.places[i] - truth.places[j])) < 3]
    along = {(i, j): np.degrees(np.arctan2(*(truth.places[j] - truth.places[i]))) + 25 for i, j in near}
    links = [(i, j, angle + rng.uniform(-15, 15)) for (i, j), angle in along.items()]
    made = tour_scene(tour_of(replace(truth, links=links)), headings=8)
    graph = made.scene.graph
    ahead = np.flatnonzero(graph[:, AHEAD] >= 0)
    assert len(ahead) == len(links)
    assert (graph[graph[ahead, AHEAD], BACK] == ahead).all()
    assert told(made, f"a move back undoes {len(links)} of {len(links)} moves ahead along links both ways (1.00)")


def test_no_other_link_lies_behind_who_came_by_a_link_one_way():
    """At the second place the link to the third lies 10 degrees beside the way back to the first."""
    truth = grid_truth(3, 1)
    links = [(0, 1, 90.0), (1, 2, 260.0), (2, 1, 80.0), (2, 0, 180.0)]
    graph = tour_scene(tour_of(replace(truth, links=links)), headings=8).scene.graph
    came = graph[:8, AHEAD].max()
    assert came // 8 == 1
    assert graph[came, BACK] == -1


@given(st.lists(st.floats(0, 359), min_size=1, max_size=12))
@settings(max_examples=60, deadline=None)
def test_the_rooms_that_a_crowded_hall_shows_and_those_that_it_hides_are_all_of_them(angles):
    """In a hall whose doors are at these angles; behind each is a room with a door back."""
    doors = list(enumerate(angles, 1))
    links = [(0, room, angle) for room, angle in doors] + [(room, 0, angle + 180) for room, angle in doors]
    made = tour_scene(tour_of(replace(grid_truth(len(angles) + 1, 1), links=links)), headings=8)
    ahead = made.scene.graph[:8, AHEAD]
    shown = set((ahead[ahead >= 0] // 8).tolist())
    hidden = set(range(1, len(angles) + 1)) - shown
    (note,) = told(made, "can be reached from each other") if hidden else ("",)
    assert bool(told(made, "shown by no heading")) == bool(hidden)
    assert not hidden or f"panoramas can be reached from each other ({len(angles) + 1} by all links); not among" in note
    assert all((f"'place_{room}'" in note) == (room in hidden) for room in range(1, len(angles) + 1))
    if len(angles) <= 4:  # there are always so many headings within 90 degrees
        assert not hidden
    back = made.scene.graph[:8, BACK]
    assert (back // 8 == np.roll(ahead // 8, 4)).all()


def test_islands_whose_headings_are_stated_are_aligned_by_them():
    truth = grid_truth(6, 2, middles=15.0 * np.arange(12))
    between = [link[:2] for link in truth.links if {link[0] // 2, link[1] // 2} in ({1, 2}, {4, 5})]
    tour = tour_of(truth, dropped=between)
    stating = tuple(replace(one, heading=float(at)) for one, at in zip(tour.panoramas, truth.middles, strict=True))
    made = tour_scene(replace(tour, panoramas=stating), headings=8)
    looks = (truth.middles[:, None] + made.yaws) % 360
    assert np.allclose(np.abs((looks - looks[:1] + 180) % 360 - 180), 0)
    names = "'place_0', 'place_1', 'place_2', 'place_3', 'place_10', 'place_11'"
    assert told(
        made, f"2 parts are not joined with the others by links both ways; their stated headings are used: {names}"
    )
    assert not told(made, "cannot be aligned")


def test_tours_and_headings_that_make_no_scene_are_refused():
    tour = tour_of(grid_truth(2, 2))
    alone = replace(tour, panoramas=tuple(replace(one, links=()) for one in tour.panoramas))
    refused("no panorama has a link to another one", tour_scene, alone)
    for headings in (0, 6, 40):
        refused(f"headings={headings}: must be a multiple of four", tour_scene, tour, headings=headings)
