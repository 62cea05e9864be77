"""The built-in rooms, and how a user names scenes."""

import re
from dataclasses import replace

import h5py
import numpy as np
import pytest
from rooms import grid_scene, published_dump

from dirl.scenes import PUBLISHED_GOALS, SceneError, catalogue, load_scenes, make_world, write_dump
from dirl.scenes.catalogue import ROOMS
from dirl.scenes.io import read

STATES = {"bathroom_02": 180, "bedroom_04": 408, "kitchen_02": 676, "living_room_08": 468}


@pytest.fixture(scope="module")
def rooms():
    return load_scenes("all")


@pytest.fixture
def folder(tmp_path):
    """Published dumps of a user: two scenes with 120 states each."""
    for name in ("bathroom_02", "bathroom_01"):
        published_dump(tmp_path / f"{name}.h5", grid_scene(width=6, depth=5))
    return tmp_path


def test_the_rooms_have_the_names_sizes_and_goals_of_the_paper(rooms):
    assert {room.name: len(room) for room in rooms} == STATES
    assert {room.name: room.goals for room in rooms} == dict(PUBLISHED_GOALS)


def test_the_published_goals_are_those_of_the_published_code():
    assert PUBLISHED_GOALS["bathroom_02"] == (26, 37, 43, 53, 69)
    assert PUBLISHED_GOALS["bedroom_04"] == (134, 264, 320, 384, 387)
    assert PUBLISHED_GOALS["kitchen_02"] == (90, 136, 157, 207, 329)
    assert PUBLISHED_GOALS["living_room_08"] == (92, 135, 193, 228, 254)


def test_the_rooms_say_that_they_are_not_the_published_scenes(rooms):
    assert {room.source for room in rooms} == {"rooms"}


def test_the_rooms_take_less_than_30_megabytes():
    assert sum(path.stat().st_size for path in ROOMS.glob("*.h5")) < 30e6


def test_the_rooms_have_features_of_one_extractor(rooms):
    assert {(room.extractor, room.features.shape[1]) for room in rooms} == {(rooms[0].extractor, 2048)}
    assert "ResNet-50" in rooms[0].extractor
    assert len(make_world(rooms)) == 1732


def test_every_goal_of_the_rooms_can_be_reached_from_every_other_state(rooms):
    for room in rooms:
        assert (make_world([room]).distances.view(5, len(room)) > 0).sum(1).tolist() == [len(room) - 1] * 5


@pytest.mark.parametrize("number", range(4))
@pytest.mark.parametrize("which", [0, -1])
def test_views_of_the_rooms_are_pictures_of_300_by_400(rooms, number, which):
    room = rooms[number]
    view = room.views[range(len(room))[which]]
    assert view.shape == (300, 400, 3)
    assert view.dtype == np.uint8
    assert view.std() > 5  # there is something to see


def test_different_states_of_a_room_look_different(rooms):
    room = rooms[0]
    assert len(np.unique(room.features, axis=0)) == len(room)
    assert (room.views[0] != room.views[1]).mean() > 0.1


@pytest.mark.parametrize(
    ("asked", "names"),
    [
        ("kitchen_02", ["kitchen_02"]),
        (["kitchen_02", "bathroom_02"], ["kitchen_02", "bathroom_02"]),
        ("all", list(STATES)),
        (["all"], list(STATES)),
    ],
)
def test_scenes_come_in_the_order_they_are_named(asked, names):
    assert [scene.name for scene in load_scenes(asked)] == names


def test_published_dumps_get_the_published_goals(folder):
    first, second = load_scenes(["bathroom_02", "bathroom_01"], source="thor", root=folder)
    assert (first.name, first.source, first.goals) == ("bathroom_02", "thor", PUBLISHED_GOALS["bathroom_02"])
    assert (second.name, second.source, second.goals) == ("bathroom_01", "thor", ())


def test_goals_in_a_dump_go_before_the_published_ones(folder):
    with h5py.File(folder / "bathroom_02.h5", "a") as file:
        file.attrs["goals"] = [3]
    assert load_scenes("bathroom_02", source="thor", root=str(folder))[0].goals == (3,)


def test_a_dump_too_small_for_the_published_goals_is_refused(tmp_path, scene):
    published_dump(tmp_path / "bathroom_02.h5", scene)
    with pytest.raises(SceneError, match=r"bathroom_02\.h5: goal 26 is not a state"):
        load_scenes("bathroom_02", source="thor", root=tmp_path)


@pytest.mark.parametrize("suffix", [".h5", ".hdf5"])
def test_a_file_is_named_by_its_path(tmp_path, scene, suffix):
    path = tmp_path / f"my{suffix}"
    write_dump(path, replace(scene, name="cellar"))
    (read,) = load_scenes(str(path))
    assert (read.name, read.source, read.goals) == ("cellar", "synthetic", (0,))


def test_a_file_among_thor_scenes_is_a_thor_scene(folder):
    paths = ["bathroom_02", str(folder / "bathroom_01.h5")]
    assert [scene.source for scene in load_scenes(paths, source="thor", root=folder)] == ["thor", "thor"]


def test_a_damaged_built_in_room_is_refused(tmp_path, monkeypatch):
    for file in ("SHA256SUMS", "bathroom_02.h5"):
        (tmp_path / file).write_bytes((ROOMS / file).read_bytes())
    for module in (catalogue, read):
        monkeypatch.setattr(module, "ROOMS", tmp_path)
    assert len(load_scenes("bathroom_02")[0]) == 180
    content = bytearray((tmp_path / "bathroom_02.h5").read_bytes())
    content[-1] ^= 1
    (tmp_path / "bathroom_02.h5").write_bytes(content)
    with pytest.raises(
        SceneError, match=r"bathroom_02\.h5: is not the built-in room that was installed \(SHA-256 diff"
    ):
        load_scenes("bathroom_02")


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: content[:-9],
        lambda content: b"",
        lambda content: content.replace(b"bathroom_02.h5", b"bathroom\xff02.h5"),
    ],
)
def test_damaged_hashes_of_the_built_in_rooms_are_refused(tmp_path, monkeypatch, damage):
    for file in ("SHA256SUMS", "bathroom_02.h5", "bathroom_02.patches.npy"):
        (tmp_path / file).write_bytes((ROOMS / file).read_bytes())
    for module in (catalogue, read):
        monkeypatch.setattr(module, "ROOMS", tmp_path)
    assert load_scenes("bathroom_02")[0].patches is not None
    (tmp_path / "SHA256SUMS").write_bytes(damage((ROOMS / "SHA256SUMS").read_bytes()))
    with pytest.raises(SceneError, match="SHA256SUMS: is not the list of hashes that was installed"):
        load_scenes("bathroom_02")


def test_the_views_of_a_built_in_room_are_found_where_libhdf5_finds_them(rooms):
    for room in rooms:
        with h5py.File(room.views.path) as file:
            stored = file["observation_webp"][:]
        assert all(room.views.encoded(state) == stored[state].tobytes() for state in range(len(room)))


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ("bathroom_2", "there is no scene 'bathroom_2' (did you mean 'bathroom_02'?); choose from ['bathroom_02', "),
        ("garage", "there is no scene 'garage'; choose from ['bathroom_02', 'bedroom_04', 'kitchen_02', 'living_ro"),
        (["kitchen_02", "garage"], "there is no scene 'garage'; choose from"),
        ("al", "there is no scene 'al' (did you mean 'all'?)"),
        ([], "no scene is named; choose e.g. scene=bathroom_02"),
        ("no/such/file.h5", "no/such/file.h5: there is no such file"),
        ("no/such/file.hdf5", "no/such/file.hdf5: there is no such file"),
    ],
)
def test_an_unknown_scene_lists_the_choices(asked, message):
    with pytest.raises(SceneError, match=f"^{re.escape(message)}"):
        load_scenes(asked)


def test_the_choices_are_those_of_the_users_folder(folder):
    with pytest.raises(SceneError, match=r"choose from \['bathroom_01', 'bathroom_02', 'all'\]"):
        load_scenes("kitchen_02", source="thor", root=folder)


def test_an_unknown_source_lists_the_choices():
    with pytest.raises(SceneError, match=r"^there is no source 'habitat'; choose one of \['rooms', 'thor'\]"):
        load_scenes("all", source="habitat")


def test_thor_needs_a_folder(tmp_path):
    with pytest.raises(SceneError, match=r"^source=thor needs the folder of your dumps: source\.root="):
        load_scenes("all", source="thor")
    with pytest.raises(SceneError, match=r"^source\.root=.*nowhere: there is no such folder"):
        load_scenes("all", source="thor", root=tmp_path / "nowhere")
