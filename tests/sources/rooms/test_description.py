"""Room descriptions: what they may hold, and one clear message for what they may not."""

import h5py
import numpy as np
import pytest
from closet import CLOSET, closet

from dirl.scenes import PUBLISHED_GOALS, SceneError
from dirl.scenes.catalogue import ROOMS
from dirl.sources.rooms import built_in_rooms, describe_room, read_description, write_description
from dirl.sources.rooms.description import description_text, parse_description
from dirl.sources.rooms.layout import assemble
from dirl.sources.rooms.materials import paint
from dirl.sources.rooms.navigation import walk

BAD = [
    ('name = "closet"', "", "name: is missing"),
    ('name = "closet"', "name = 3", "name: must be a valid string, found 3"),
    ('name = "closet"', 'nam = "closet"', "there is no 'nam'; did you mean 'name'?"),
    ("goals = [3]", "goals = [3.5]", "goals[0]: must be a valid integer, found 3.5"),
    ('floor = "boards"', "", "room.floor: is missing"),
    ('floor = "boards"', 'flor = "boards"', "room: there is no 'flor'; did you mean 'floor'?"),
    ("[2.0, 1.5, 2.4]", "[2.0, 1.6]", "room.size[2]: is missing"),
    ("[2.0, 1.5, 2.4]", "[2.0, -1, 2.4]", "room.size[1]: must be greater than 0, found -1"),
    ("[2.0, 1.5, 2.4]", "[2.0, nan, 2.4]", "room.size[1]: must be a valid number, found 'NaN'"),
    ('east = "brick"', "", "[room.walls]: east: is missing"),
    ('east = "brick"', "east = 4", "[room.walls]: east: must be a valid array, found 4"),
    ('[2.4, "paper"]', '[2.0, "paper"]', "[room.walls]: north: the upper edges of the bands must rise to the room's"),
    ("[grid]", "[grid]\nstart = 1", "grid: there is no 'start'; choose from origin, step, radius, places"),
    ("[grid]", "[camera]\nfov = true\n[grid]", "camera.fov: must be a valid number, found True"),
    ('kind = "tile"', 'kind = "tiel"', "[materials] tiles: kind: there is no 'tiel'; did you mean 'tile'?"),
    ("nx = 4", "nx = 4.5", "[materials] tiles: nx: must be a valid integer, found 4.5"),
    ("rows = 4", "rws = 4", "[materials] boards: there is no 'rws'; did you mean 'rows'?"),
    ("rows = 4", "rows = 4, rough = -1", "[materials] boards: rough: must be greater than or equal to 0, found -1"),
    ("resolution = 64", "resolution = 4096", "[materials] boards: resolution: must be less than or equal to 2048"),
    ('kind = "stool"', 'kind = "stool"\noptions = {}', "[[furniture]] number 1 (stool): there is no 'options'"),
    ("size = [0.3, 0.3, 0.45]", "size = [0.3, 0.3, 45]", "[[furniture]] number 1 (stool): size[2]: must be less than"),
    ("resolution = 64", "resolution = 100", "[materials] boards: resolution: must be a power of two, found 100"),
    ('kind = "stool"', 'kind = "stol"', "[[furniture]] number 1 (stol): kind: there is no 'stol'; did you mean"),
    ('kind = "stool"', "", "[[furniture]] number 1: kind: is missing"),
    ('kind = "stool"', 'kind = "stool"\nlegs = 3', "[[furniture]] number 1 (stool): there is no 'legs'"),
    ("size = [0.3, 0.3, 0.45]", "", "[[furniture]] number 1 (stool): size: is missing"),
    ("at = [1.5, 1.2]", "", "[[furniture]] number 1 (stool): say where it stands, by 'wall' and 'along', or by 'at'"),
    ("along = 0.7", "", "[[furniture]] number 2 (door): say where it stands"),
    ('wall = "south"', 'wall = "sout"', "[[furniture]] number 2 (door): wall: there is no 'sout'; did you mean"),
    ("[grid]", "[grid", "not TOML:"),
]


@pytest.mark.parametrize(("old", "new", "message"), BAD)
def test_what_cannot_be_used_is_refused_with_its_place_and_name(old, new, message):
    with pytest.raises(SceneError) as refused:
        closet(old, new)
    assert str(refused.value).startswith(message)
    assert "\n" not in str(refused.value)


def test_a_description_is_written_and_read_back(tmp_path):
    write_description(closet(), tmp_path / "closet.toml")
    assert read_description(tmp_path / "closet.toml") == closet()
    with pytest.raises(SceneError, match="this file exists already"):
        write_description(closet(), tmp_path / "closet.toml")


def test_an_error_names_the_file(tmp_path):
    (tmp_path / "bad.toml").write_text(CLOSET.replace("name", "nam", 1))
    with pytest.raises(SceneError, match=r"bad.toml: there is no 'nam'"):
        describe_room(tmp_path / "bad.toml")
    with pytest.raises(SceneError, match=r"there is no built-in room 'bathrom'; choose from bathroom_02"):
        describe_room("bathrom")


def test_something_of_an_unknown_material_is_named():
    with pytest.raises(SceneError, match=r"^\[room\]: there is no material 'bords'; describe it under \[materials\]$"):
        assemble(closet('floor = "boards"', 'floor = "bords"'))
    stool = closet('kind = "stool"', 'kind = "stool"\nbody = "gold"')
    with pytest.raises(SceneError, match=r"^\[\[furniture\]\] number 1 \(stool\): there is no material 'gold'"):
        assemble(stool)


def test_a_color_that_is_none_is_named():
    room = closet('motif = "#c8553d"', 'motif = "red"')
    with pytest.raises(SceneError, match=r"\[materials\] paper: 'red' is no colour"):
        paint("paper", room.materials["paper"])


@pytest.mark.parametrize("name", built_in_rooms())
def test_a_built_in_room_has_the_graph_that_is_shipped(name):
    room = describe_room(name)
    assert parse_description(description_text(room)) == room
    assert (room.name, room.goals) == (name, PUBLISHED_GOALS[name])
    way = walk(room)
    with h5py.File(ROOMS / f"{name}.h5") as file:
        assert (way.graph == file["graph"][:]).all()
        assert np.abs(np.repeat(way.places, 4, 0) - file["location"][:]).max() < 1e-6
        assert (np.tile(way.headings, len(way.places)) == file["rotation"][:]).all()
