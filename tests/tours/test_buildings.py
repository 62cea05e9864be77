"""Tours of rooms joined by doors: every room is in the scene, and headings that links do not give are seen."""

import numpy as np
import pytest
from closet import closet
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from tours import WRITERS, Camera360, Truth

from dirl.rooms.building import Building, sample_building
from dirl.rooms.building_tour import choose_panoramas, write_building_tour
from dirl.tours import read_tour
from dirl.tours.moves import tour_scene

KINDS = {10101: ("living_room", "kitchen", "bedroom"), 10301: ("bathroom", "bedroom", "bathroom", "living_room")}


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
@pytest.mark.parametrize("kind", WRITERS)
def test_every_room_that_a_tour_connects_is_in_the_scene(kind, seed, tmp_path):
    truth = building_truth(seed)
    tour = read_tour(WRITERS[kind](tmp_path, truth, Camera360(), 8))
    number = {panorama.id: index for index, panorama in enumerate(tour.panoramas)}
    links = {(number[one.id], number[link.target]) for one in tour.panoramas for link in one.links}
    if kind != "zind":  # whose links are the distances
        assert len(links) == len(truth.links)
        assert 0.2 < np.mean([(b, a) not in links for a, b in links]) < 0.6
    scene = tour_scene(tour, headings=8, compare_images=False).scene
    states = np.repeat(np.arange(len(number)), 8)
    moves = {(states[s], states[t]) for s, ends in enumerate(scene.graph) for t in ends if t >= 0}
    assert together(len(number), moves) >= 0.98 * together(len(number), links)


@pytest.fixture(scope="module")
def closets(tmp_path_factory):
    """A tour of two closets joined by a door, with what is true of it."""
    pytest.importorskip("embreex")
    folder = tmp_path_factory.mktemp("closets")
    building = Building("closets", (closet(), closet("#c8553d", "#205080")), (0.6,))
    found = write_building_tour(building, folder, apart=0.8, size=(96, 192))
    return read_tour(folder), found, np.random.default_rng(0).uniform(0, 360, len(found.places))
