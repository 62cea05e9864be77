"""Tours of rooms joined by doors: every room is in the scene, and headings that links do not give are seen."""

from dataclasses import replace

import numpy as np
import pytest
from buildings import Building, write_building_tour
from closet import closet
from PIL import Image
from tours import grid_truth, heading_errors, tour_of, turned

from dirl.sources.tours import read_tour
from dirl.sources.tours.alignment import LEAD, align, wrap
from dirl.sources.tours.conversion import tour_scene
from dirl.sources.tours.pixels import Equirectangular
from dirl.sources.tours.rotation import Seen, columns, compare


@pytest.fixture(scope="module")
def closets(tmp_path_factory):
    """A tour of two closets joined by a door, and where the middle of each panorama looks."""
    pytest.importorskip("embreex")
    folder = tmp_path_factory.mktemp("closets")
    building = Building("closets", (closet(), closet("#c8553d", "#205080")), (0.6,))
    found = write_building_tour(building, folder, apart=0.45, size=(96, 192))
    return read_tour(folder), np.random.default_rng(0).uniform(0, 360, len(found.places))


def changed(tour, cut=(), off=0.0):
    """The tour without some links, by start and end, and with arrows that are up to ``off`` degrees beside the way."""
    rng = np.random.default_rng(0)
    panoramas = []
    for one in tour.panoramas:
        links = [replace(link, yaw=link.yaw + rng.uniform(-off, off)) for link in one.links]
        panoramas.append(replace(one, links=tuple(link for link in links if (one.id, link.target) not in cut)))
    return replace(tour, panoramas=tuple(panoramas))


def test_headings_that_links_one_way_leave_open_are_seen(closets):
    tour, middles = closets
    pairs = sorted({tuple(sorted((one.id, link.target))) for one in tour.panoramas for link in one.links})
    one_way = changed(tour, {pair if number % 4 else pair[::-1] for number, pair in enumerate(pairs) if number % 2})
    made, by_links = tour_scene(one_way), tour_scene(one_way, compare_images=False)
    off, without = (heading_errors(one.scene.headings[0] - one.yaws[:, 0], middles).max() for one in (made, by_links))
    assert off <= 3
    assert without > 30
    (note,) = [note for note in made.notes if "that were compared" in note]
    assert note.startswith(
        f"{len(pairs) // 2} of {len(pairs) // 2} pairs of panoramas that were compared show how they"
    )


def test_what_panoramas_show_takes_the_place_of_links_that_are_missing_or_wrong():
    truth = turned(grid_truth(4, 3), 1.0)
    off = np.zeros(len(truth.links))
    off[[truth.links.index(link) for link in truth.links if link[:2] == (4, 5)]] = 130
    one_way = [(a, b) for a, b, _ in truth.links if a < b and (a + b) % 3]
    tour = tour_of(truth, off, one_way)
    turn = {(a, b): wrap(np.array(truth.middles[b] - truth.middles[a])) for a, b, _ in truth.links}
    seen = {pair: Seen(float(turn[pair]), 1.0) for pair in [*((b, a) for a, b in one_way), (4, 5)]}
    made = align(tour, seen)
    assert heading_errors(made.headings, truth.middles).max() < 1e-6
    assert (made.part == 0).all()
    assert made.loops.max() < 1e-6
    unsure = {pair: replace(found, lead=LEAD / 2) for pair, found in seen.items()}
    assert (align(tour, unsure).part > 0).any()


def test_of_a_lone_loop_that_does_not_close_the_pair_with_a_near_rival_is_left_out():
    truth = turned(grid_truth(2, 2), 1.0)
    ways = sorted({tuple(sorted(link[:2])) for link in truth.links})
    assert len(ways) == 4
    turn = {(a, b): float(wrap(np.array(truth.middles[b] - truth.middles[a]))) for a, b in ways}
    for wrong in ways:
        seen = {pair: Seen(turn[pair], 1.0) for pair in ways} | {wrong: Seen(turn[wrong] + 150, 1.0, 0.5)}
        made = align(tour_of(truth, None, [(b, a) for a, b in ways]), seen)
        assert heading_errors(made.headings, truth.middles).max() < 1e-6, wrong


def test_pictures_that_show_nothing_are_not_believed(tmp_path):
    Image.new("RGB", (64, 32), "grey").save(tmp_path / "grey.png")
    grey = columns(Equirectangular(tmp_path / "grey.png"))
    assert compare(grey, grey, [0.0]).lead < LEAD
