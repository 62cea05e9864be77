"""Room descriptions, one clear message for what they may not hold; where agents can stand and go, found out plainly."""

import h5py
import numpy as np
import pytest
from closet import CLOSET, closet
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused

from dirl.scenes import PUBLISHED_GOALS
from dirl.scenes.catalogue import ROOMS
from dirl.scenes.graph import AHEAD, BACK
from dirl.sources.rooms import built_in_rooms, check_room, describe_room, description_text, read_description
from dirl.sources.rooms.description import parse_description
from dirl.sources.rooms.dump import scene_of
from dirl.sources.rooms.layout import assemble
from dirl.sources.rooms.materials import paint
from dirl.sources.rooms.walkable import clearance, walk

BAD = [
    ('name = "closet"', "", "name: is missing"),
    ('floor = "boards"', 'flor = "boards"', "room: there is no 'flor'; did you mean 'floor'?"),
    ("[2.0, 1.5, 2.4]", "[2.0, -1, 2.4]", "room.size[1]: must be greater than 0, found -1"),
    ('[2.4, "paper"]', '[2.0, "paper"]', "[room.walls]: north: the upper edges of the bands must rise to the room's"),
    ("resolution = 64", "resolution = 100", "[materials] boards: resolution: must be a power of two, found 100"),
    ('kind = "stool"', 'kind = "stool"\noptions = {}', "[[furniture]] number 1 (stool): there is no 'options'"),
    ("along = 0.7", "", "[[furniture]] number 2 (door): say where it stands"),
    ("[grid]", "[grid", "not TOML:"),
]


@pytest.mark.parametrize(("old", "new", "message"), BAD)
def test_what_cannot_be_used_is_refused_with_its_place_and_name(old, new, message):
    assert refused(".", closet, old, new).startswith(message)


def test_a_description_is_written_and_read_back_and_an_error_names_the_file(tmp_path):
    (tmp_path / "closet.toml").write_text(description_text(closet()))
    assert read_description(tmp_path / "closet.toml") == closet()
    (tmp_path / "bad.toml").write_text(CLOSET.replace("name", "nam", 1))
    refused(r"bad.toml: there is no 'nam'", describe_room, tmp_path / "bad.toml")
    refused(r"there is no built-in room 'bathrom'; did you mean 'bathroom_02'", describe_room, "bathrom")


def test_materials_and_colours_that_are_none_are_named():
    told = r"^\[room\]: there is no material 'bords'; describe it under \[materials\]$"
    refused(told, assemble, closet('floor = "boards"', 'floor = "bords"'))
    told = r"^\[\[furniture\]\] number 1 \(stool\): there is no material 'gold'"
    refused(told, assemble, closet('kind = "stool"', 'kind = "stool"\nbody = "gold"'))
    room = closet('motif = "#c8553d"', 'motif = "red"')
    refused(r"\[materials\] paper: 'red' is no colour", paint, "paper", room.materials["paper"])


@pytest.mark.parametrize("name", built_in_rooms())
def test_a_built_in_room_has_no_problems_and_the_graph_that_is_shipped(name):
    room = describe_room(name)
    assert check_room(room) == []
    assert parse_description(description_text(room)) == room
    assert (room.name, room.goals) == (name, PUBLISHED_GOALS[name])
    way = walk(room)
    with h5py.File(ROOMS / f"{name}.h5") as file:
        assert (way.graph == file["graph"][:]).all()
        assert np.abs(np.repeat(way.places, 4, 0) - file["location"][:]).max() < 1e-6
        assert (np.tile(way.headings, len(way.places)) == file["rotation"][:]).all()


COORDINATE = st.floats(-3, 3, allow_nan=False)
POINT = st.tuples(COORDINATE, COORDINATE)


@given(POINT, POINT, POINT, st.floats(0.05, 1.5), st.floats(0.05, 1.5), st.floats(-4, 4))
def test_the_distance_of_a_segment_is_that_of_its_nearest_point(a, b, middle, half_width, half_depth, turn):
    rectangle = np.array([[*middle, half_width, half_depth, turn]])
    exact = clearance(np.array([a]), np.array([b]), rectangle)[0]
    share = np.linspace(0, 1, 2001)[:, None]
    points = np.array(a) * (1 - share) + np.array(b) * share
    dense = clearance(points, points, rectangle).min()
    assert dense - np.hypot(*np.subtract(a, b)) / 2000 <= exact <= dense + 1e-9


@pytest.mark.parametrize(("turn", "headings", "moves"), [(45, 8, 16), (30, 12, 10)])
def test_smaller_turns_have_more_headings_and_move_only_onto_the_grid(turn, headings, moves):
    way = walk(closet(), turn)
    scene = scene_of(closet(), way)  # checks the graph
    assert len(scene) == 5 * headings
    assert (way.graph[:, AHEAD] >= 0).sum() == (way.graph[:, BACK] >= 0).sum() == moves
    moving = np.flatnonzero(way.graph[:, AHEAD] >= 0)
    step = scene.positions[way.graph[moving, AHEAD]] - scene.positions[moving]
    assert np.allclose(np.degrees(np.arctan2(step[:, 0], step[:, 1])) % 360, scene.headings[moving])


def test_turns_and_grids_that_leave_no_scene_are_refused():
    for turn in (0, -90, 50, 180, 89.9):
        refused("must go into 90 degrees", walk, closet(), turn)
    refused(r"\[grid\] places: the room has 5 places, not 6", walk, closet("places = 5", "places = 6"))
    wide = closet("origin = [0.4, 0.4]", "origin = [0.4, 0.4]\nradius = 0.9")
    refused("there is no place where the agent can stand", walk, wide)
