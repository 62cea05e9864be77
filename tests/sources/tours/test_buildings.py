"""The headings of panoramas, by the yaws of links both ways and by what is seen; tours of rooms joined by doors."""

from dataclasses import replace

import numpy as np
import pytest
from buildings import WALL, Building, choose_panoramas, sample_building, walk_poses, write_building_tour
from closet import closet
from PIL import Image
from tours import grid_truth, heading_errors, tour_of, turned

from dirl.sources.tours import read_tour
from dirl.sources.tours.alignment import LEAD, align, wrap
from dirl.sources.tours.conversion import tour_scene
from dirl.sources.tours.pixels import Equirectangular
from dirl.sources.tours.rotation import Seen, columns, compare

CLOSETS = Building("closets", (closet(), closet("#c8553d", "#205080")), (0.6,))
"""Two closets joined by a door."""


def test_headings_that_links_one_way_leave_open_are_seen(tmp_path):
    pytest.importorskip("embreex")
    found = write_building_tour(CLOSETS, tmp_path, apart=0.45, size=(96, 192))
    tour, middles = read_tour(tmp_path), np.random.default_rng(0).uniform(0, 360, len(found.places))
    pairs = sorted({tuple(sorted((one.id, link.target))) for one in tour.panoramas for link in one.links})
    cut = {pair if number % 4 else pair[::-1] for number, pair in enumerate(pairs) if number % 2}
    left = {one.id: tuple(link for link in one.links if (one.id, link.target) not in cut) for one in tour.panoramas}
    one_way = replace(tour, panoramas=tuple(replace(one, links=left[one.id]) for one in tour.panoramas))
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
    seen = {pair: Seen(float(turn[pair]), 0.6) for pair in [*((b, a) for a, b in one_way), (4, 5)]}
    made = align(tour, seen)
    assert heading_errors(made.headings, truth.middles).max() < 1e-6
    assert (made.part == 0).all()
    assert made.loops.max() < 1e-6
    unsure = {pair: replace(found, lead=0.4) for pair, found in seen.items()}
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


def test_panoramas_turned_at_random_are_aligned_again_and_links_that_are_all_wrong_left_out():
    truth = turned(grid_truth(6, 5), 1.0)
    found = align(tour_of(truth))
    assert heading_errors(found.headings, truth.middles).max() < 1e-6
    assert found.loops.max() < 1e-6
    assert len(found.loops) == 49 - 29  # links less a spanning tree
    assert (found.part == 0).all()
    assert (found.rejected, found.one_way) == ([], [])
    rng = np.random.default_rng(0)
    far_apart = {(6, 11), (8, 9), (17, 22), (19, 24)}  # whatever part is cut off, most of the links to it are right
    pairs = [index for index, link in enumerate(truth.links) if link[:2] in far_apart]
    off = np.zeros(len(truth.links))
    off[pairs] = rng.uniform(40, 180, len(pairs)) * rng.choice([-1, 1], len(pairs))
    found = align(tour_of(truth, off))
    assert heading_errors(found.headings, truth.middles).max() < 1e-6
    assert {pair[:2] for pair in found.rejected} == {truth.links[index][:2] for index in pairs}
    assert min(pair[2] for pair in found.rejected) > 39.9
    assert found.loops.max() > 39.9


def test_the_tour_of_a_building_reads_back(tmp_path):
    found = write_building_tour(CLOSETS, tmp_path / "tour", apart=0.8, size=(16, 32))
    assert found.places[0].tolist() == pytest.approx([2.0 + WALL / 2, 0.6])
    far = np.linalg.norm(found.places[:, None] - found.places, axis=-1)[~np.eye(len(found.places), dtype=bool)]
    assert far.min() >= 0.8
    tour = read_tour(tmp_path / "tour")
    made = tour_scene(tour, headings=8)
    numbers = {panorama.id: index for index, panorama in enumerate(tour.panoramas)}
    links = {(numbers[one.id], numbers[link.target]) for one in tour.panoramas for link in one.links}
    assert links == set(map(tuple, found.links.tolist()))
    assert (found.places[:, 0] > 2 + WALL).any()  # in both rooms
    assert (found.places[:, 0] < 2).any()
    assert made.scene.positions[::8] == pytest.approx(found.places, abs=1e-3)
    assert (made.scene.distances >= 0).all()
    # Headings are aligned: one turn of the whole map brings every link where it is.
    along = np.degrees(np.arctan2(*(found.places[found.links[:, 1]] - found.places[found.links[:, 0]]).T))
    written = [link.yaw for a, b in found.links for link in tour.panoramas[a].links if numbers[link.target] == b]
    middles = made.scene.headings[::8] - made.yaws[:, 0]
    off = wrap(along - np.array(written) - middles[found.links[:, 0]])
    assert np.abs(wrap(off - off[0])).max() < 1


def test_buildings_in_a_row_are_as_they_were():
    building = sample_building(["bathroom", "bedroom", "bathroom"], 10_200)
    assert building.doors == (1.55, 2.55)
    assert building.doorways == pytest.approx(np.array([(4.46, 1.55), (10.68, 2.55)]))
    assert [len(room.furniture) for room in building.rooms] == [25, 24, 23]
    found = choose_panoramas(building)
    assert (len(found.places), len(found.links)) == (15, 36)
    assert found.places.sum() == pytest.approx(149.49)
    poses = np.array(walk_poses(building))
    assert poses[0, 0] < 4.4 < 10.7 < poses[-1, 0]
    assert np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1).max() <= 0.5
    assert np.abs(wrap(np.diff(poses[:, 2]))).max() <= 15
