"""Tours of rooms joined by doors: every room is in the scene, and headings that links do not give are seen."""

from dataclasses import replace

import numpy as np
import pytest
from closet import closet
from PIL import Image
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from tours import Truth, grid_truth, tour_of, turned

from dirl.sources.rooms.building import Building, choose_panoramas, sample_building, write_building_tour
from dirl.sources.tours import read_tour
from dirl.sources.tours.alignment import LEAD, align, wrap
from dirl.sources.tours.columns import Seen, columns, compare
from dirl.sources.tours.images import Equirectangular
from dirl.sources.tours.moves import tour_scene

KINDS = {
    10101: ("living_room", "kitchen", "bedroom"),
    10301: ("bathroom", "bedroom", "bathroom", "living_room"),
}


def building_truth(seed):
    """A tour of rooms joined by doors, panoramas 2 m apart: a third of the links lead one way, sectors are crowded."""
    found, rng = choose_panoramas(sample_building(KINDS[seed], seed)), np.random.default_rng(seed)
    places, links = found.places, {(int(a), int(b)) for a, b in found.links}
    # Real tours also link what can be seen through a door: two arrows, or three, in one sector.
    links |= {(a, d) for a, b in links for c, d in links if b == c and a != d and rng.random() < 0.15}
    for a, b in sorted(links):
        if a < b and (b, a) in links and rng.random() < 0.5:
            links.remove((a, b) if rng.random() < 0.5 else (b, a))
    along = {(a, b): float(np.degrees(np.arctan2(*(places[b] - places[a]))) % 360) for a, b in sorted(links)}
    return Truth(places, rng.uniform(0, 360, len(places)), [(a, b, angle) for (a, b), angle in along.items()])


def together(count, pairs):
    """How many are in the largest group that can be reached from each other."""
    ends = np.array(sorted(pairs)).reshape(-1, 2)
    links = csr_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count))
    return np.bincount(connected_components(links, connection="strong")[1]).max()


@pytest.mark.parametrize("seed", KINDS)
def test_every_room_that_a_tour_connects_is_in_the_scene(seed):
    truth = building_truth(seed)
    links = {link[:2] for link in truth.links}
    assert 0.2 < np.mean([(b, a) not in links for a, b in links]) < 0.6
    count = len(truth.places)
    scene = tour_scene(tour_of(truth), headings=8, compare_images=False).scene
    moves = {(s // 8, t // 8) for s, ends in enumerate(scene.graph.tolist()) for t in ends if t >= 0}
    assert together(count, moves) >= 0.98 * together(count, links)


@pytest.fixture(scope="module")
def closets(tmp_path_factory):
    """A tour of two closets joined by a door, and where the middle of each panorama looks."""
    pytest.importorskip("embreex")
    folder = tmp_path_factory.mktemp("closets")
    building = Building("closets", (closet(), closet("#c8553d", "#205080")), (0.6,))
    found = write_building_tour(building, folder, apart=0.45, size=(96, 192))
    return read_tour(folder), np.random.default_rng(0).uniform(0, 360, len(found.places))


def errors(made, middles):
    """How far off the headings of panoramas are, degrees, up to the zero that they share."""
    off = np.radians(made.scene.headings[0] - made.yaws[:, 0] - middles)
    return np.abs(wrap(np.degrees(off - np.angle(np.exp(1j * off).mean()))))


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
    made = tour_scene(one_way)
    assert errors(made, middles).max() <= 3
    assert errors(tour_scene(one_way, compare_images=False), middles).max() > 30
    (note,) = [note for note in made.notes if "that were compared" in note]
    assert note.startswith(
        f"{len(pairs) // 2} of {len(pairs) // 2} pairs of panoramas that were compared show how they"
    )


def test_headings_of_links_that_contradict_each_other_are_seen(closets):
    tour, middles = closets
    made = tour_scene(changed(tour, off=50.0))
    assert errors(made, middles).max() <= 6
    before, after = (float(note.split("median error of ")[1].split()[0]) for note in made.notes if "median" in note)
    assert before > 15 > after


def test_what_panoramas_show_takes_the_place_of_links_that_are_missing_or_wrong():
    truth = turned(grid_truth(4, 3), 1.0)
    off = np.zeros(len(truth.links))
    off[[truth.links.index(link) for link in truth.links if link[:2] == (4, 5)]] = 130
    one_way = [(a, b) for a, b, _ in truth.links if a < b and (a + b) % 3]
    tour = tour_of(truth, off, one_way)
    turn = {(a, b): wrap(np.array(truth.middles[b] - truth.middles[a])) for a, b, _ in truth.links}
    seen = {pair: Seen(float(turn[pair]), 1.0) for pair in [*((b, a) for a, b in one_way), (4, 5)]}
    made = align(tour, seen)
    off = np.radians(made.headings - truth.middles)
    assert np.abs(wrap(np.degrees(off - off[0]))).max() < 1e-6
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
        off = align(tour_of(truth, None, [(b, a) for a, b in ways]), seen).headings - truth.middles
        assert np.abs(wrap(off - off[0])).max() < 1e-6, wrong


def test_pictures_that_show_nothing_are_not_believed(tmp_path):
    Image.new("RGB", (64, 32), "grey").save(tmp_path / "grey.png")
    grey = columns(Equirectangular(tmp_path / "grey.png"))
    assert compare(grey, grey, [0.0]).lead < LEAD
