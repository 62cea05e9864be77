"""Rooms joined by doorways: what can be walked and seen through, and the tours of them."""

from dataclasses import replace

import numpy as np
import pytest
from closet import closet

from dirl.scenes import SceneError
from dirl.sources.rooms.building import (
    APPROACH,
    DOORWAY,
    WALL,
    Building,
    _cleared,
    assemble_building,
    furniture,
    sample_building,
    walls,
)
from dirl.sources.rooms.building_tour import choose_panoramas, write_building_tour
from dirl.sources.rooms.navigation import clearance
from dirl.sources.rooms.scenery import Scenery
from dirl.sources.tours import read_tour
from dirl.sources.tours.alignment import wrap
from dirl.sources.tours.moves import tour_scene


@pytest.fixture(scope="module")
def building():
    """Two closets side by side."""
    return Building("closets", (closet(), closet("#c8553d", "#205080")), (0.6,))


def test_a_doorway_can_be_seen_and_walked_through(building):
    scenery = Scenery(*assemble_building(building), edge=1.0, texture_limit=16)
    east = np.array([[1.0, 0.0, 0.0]] * 3)
    through, beside, above = (0.6, 0.6, 1.0), (0.6, 1.3, 1.0), (1.5, 0.6, DOORWAY[1] + 0.1)
    distance = scenery.trace(np.array([through, beside, above]), east).distance
    assert distance == pytest.approx([3.4 + WALL, 1.4, 0.5], abs=1e-4)
    inside = scenery.trace(np.array([(2.0 + WALL / 2, 0.6, 1.0)] * 2), np.array([[0.0, 1, 0], [0, 0, -1]])).distance
    assert inside == pytest.approx([DOORWAY[0] / 2, 1.0], abs=1e-4)
    solid = np.concatenate([walls(building), furniture(building)])
    starts = np.array([(1.0, 0.6), (1.0, 1.3), (0.5, 0.6), (0.5, 0.6)])
    ends = np.array([(3.0, 0.6), (3.0, 1.3), (-0.5, 0.6), (0.5, 2.0)])
    assert (clearance(starts, ends, solid) > 0).tolist() == [True, False, False, False]


def test_what_stands_before_a_doorway_goes_with_what_stands_on_it():
    room = closet('kind = "stool"\nat = [1.5, 1.2]', 'kind = "stool"\nat = [1.6, 0.9]')
    left = [piece.kind for piece in _cleared(room, 2.0, 0.9).furniture]
    assert left == ["door", "ceiling_lamp"]
    assert len(_cleared(room, 0.0, 0.9).furniture) == 3


def test_the_tour_of_a_building_reads_back(building, tmp_path):
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


def test_buildings_have_two_to_eight_rooms_of_known_kinds():
    for kinds in (["kitchen"], ["kitchen", "cave"], ["kitchen"] * 9):
        with pytest.raises(SceneError, match="expected two to eight of bathroom"):
            sample_building(kinds, 0)


@pytest.fixture(scope="module")
def two_rows():
    """Two closets side by side, and a third one south of the first."""
    bare = replace(closet(), furniture=closet().furniture[-1:])
    return Building("closets", (closet(), closet("#c8553d", "#205080"), bare), (2.3,), south=1, across=(1.5,))


def test_a_doorway_between_rows_can_be_seen_and_walked_through(two_rows):
    assert two_rows.size[:2] == pytest.approx((4 + WALL, 3 + WALL))
    assert two_rows.corners == pytest.approx(np.array([(0, 1.5 + WALL), (2 + WALL, 1.5 + WALL), (0, 0)]))
    assert two_rows.doorways == pytest.approx(np.array([(2 + WALL / 2, 2.3), (1.5, 1.5 + WALL / 2)]))
    scenery = Scenery(*assemble_building(two_rows), edge=1.0, texture_limit=16)
    north = np.array([[0.0, 1.0, 0.0]] * 3)
    through, beside, above = (1.5, 0.6, 1.0), (0.5, 0.6, 1.0), (1.5, 1.0, DOORWAY[1] + 0.1)
    distance = scenery.trace(np.array([through, beside, above]), north).distance
    assert distance == pytest.approx([2.4 + WALL, 0.9, 0.5], abs=1e-4)
    inside = scenery.trace(np.array([(1.5, 1.5 + WALL / 2, 1.0)] * 2), np.array([[1.0, 0, 0], [0, 0, -1]])).distance
    assert inside == pytest.approx([DOORWAY[0] / 2, 1.0], abs=1e-4)
    solid = np.concatenate([walls(two_rows), furniture(two_rows)])
    starts = np.array([(1.5, 0.8), (0.5, 0.8), (0.8, 2.3), (1.0, 0.8), (3.0, 1.9), (3.0, 0.8)])
    ends = np.array([(1.5, 2.2), (0.5, 2.2), (3.0, 2.3), (3.0, 0.8), (3.0, 1.3), (3.5, 0.8)])
    # The last three lead out of the second row, out of the first, and through what lies outside of both.
    assert (clearance(starts, ends, solid) > 0).tolist() == [True, False, True, False, False, False]


def rooms_of(building, places):
    """The room of each place; -1 outside."""
    low, high = building.corners, building.corners + [room.size[:2] for room in building.rooms]
    inside = ((places[:, None] > low) & (places[:, None] < high)).all(-1)
    return [int(np.flatnonzero(row)[0]) if row.any() else -1 for row in inside]


def test_every_room_of_a_larger_building_is_reached():
    building = sample_building(["bathroom", "bedroom", "bathroom", "bedroom", "bathroom"], 10_200)
    assert building.south == 2
    assert len(building.passages) == 5  # one more than a tree has: the rows are joined twice
    solid = np.concatenate([walls(building), furniture(building)])
    for door, middle in zip(building.passages, building.doorways, strict=True):
        way = np.eye(2)[door.axis] * APPROACH
        assert clearance(middle[None] - way, middle[None] + way, solid)[0] > 0.4
    found = choose_panoramas(building)  # which refuses doorways that cannot be reached
    assert found.places[:5] == pytest.approx(building.doorways)
    assert set(rooms_of(building, found.places[5:])) == set(range(5))


def test_buildings_in_a_row_are_as_they_were():
    building = sample_building(["bathroom", "bedroom", "bathroom"], 10_200)
    assert building.doors == (1.55, 2.55)
    assert building.doorways == pytest.approx(np.array([(4.46, 1.55), (10.68, 2.55)]))
    assert [len(room.furniture) for room in building.rooms] == [25, 24, 23]
    found = choose_panoramas(building)
    assert (len(found.places), len(found.links)) == (15, 36)
    assert found.places.sum() == pytest.approx(149.49)
