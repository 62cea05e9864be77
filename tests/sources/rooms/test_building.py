"""Rooms joined by doorways: what can be walked and seen through, and the tours of them."""

import numpy as np
import pytest
from buildings import WALL, Building, choose_panoramas, sample_building, walk_poses, write_building_tour
from closet import closet

from dirl.sources.tours import read_tour
from dirl.sources.tours.alignment import wrap
from dirl.sources.tours.conversion import tour_scene


def test_the_tour_of_a_building_reads_back(tmp_path):
    building = Building("closets", (closet(), closet("#c8553d", "#205080")), (0.6,))
    found = write_building_tour(building, tmp_path / "tour", apart=0.8, size=(16, 32))
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
