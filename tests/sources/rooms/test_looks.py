"""Further looks of a room: the errors of its visits."""

from dataclasses import replace

import numpy as np
import pytest
from closet import closet

pytest.importorskip("embreex")

from dirl.perception.photos import as_seen_by
from dirl.scenes import SceneError
from dirl.sources.rooms.build import poses
from dirl.sources.rooms.checks import check_room
from dirl.sources.rooms.looks import Changes, PhotoCamera, changed_room, look_views
from dirl.sources.rooms.navigation import walk
from dirl.sources.rooms.view import Renderer

SIZE = (24, 32)


def views_of(room):
    """What gives the views of a room's looks: without errors, but for those that are asked for."""
    way, renderer = walk(room), Renderer.of(room, fine=False)
    none = {"position": 0, "heading": 0, "exposure": 0}

    def views(seed=0, photo=None, **changes):
        made = Changes(**{**none, **changes})
        return np.stack(list(look_views(renderer, room, way, SIZE, made, seed, fine=False, photo=photo))).astype(float)

    return views


@pytest.fixture(scope="module")
def look():
    return views_of(closet())


def difference(one, other):
    return np.abs(one - other).mean()


def test_without_errors_every_look_is_the_same(look):
    assert np.array_equal(look(seed=0), look(seed=1))


@pytest.mark.parametrize(
    "change", [{"position": 0.05}, {"heading": 5}, {"exposure": 0.2}, {"white_balance": 0.2}, {"camera_height": 0.1}]
)
def test_each_error_changes_the_views_and_more_of_it_more(look, change):
    (name, size), planned = *change.items(), look()
    some, more = (difference(look(**{name: factor * size}), planned) for factor in (1, 3))
    assert 0.3 < some < more
    assert np.array_equal(look(**change), look(**change))
    assert not np.array_equal(look(seed=1, **change), look(**change))


def test_the_four_views_of_a_place_share_their_exposure(look):
    brightness = (look(exposure=0.2).mean((1, 2, 3)) / look().mean((1, 2, 3))).reshape(-1, 4)
    assert brightness.std(1).max() < 0.05
    assert brightness.mean(1).std() > 0.05


def test_errors_that_vary_are_of_another_size_in_each_look(look):
    planned = look()
    alike = [difference(look(seed, heading=5), planned) for seed in range(6)]
    varied = [difference(look(seed, heading=5, vary=0.9), planned) for seed in range(6)]
    assert np.std(varied) > 2 * np.std(alike)


@pytest.mark.parametrize("photo", [{"aside": 20}, {"fov": 50}, {"tilt": 10}, {"jpeg": 20}, {"warmth": 0.3}])
def test_photos_of_another_camera_differ_from_its_views(look, photo):
    taken = look(photo=PhotoCamera(**photo))
    assert difference(taken, look()) > 1
    assert np.array_equal(taken, look(photo=PhotoCamera(**photo)))


def test_a_photo_with_half_the_field_of_view_shows_the_middle_of_the_view(look):
    half = 2 * np.degrees(np.arctan(np.tan(np.radians(75 / 2)) / 2))
    near, planned = look(photo=PhotoCamera(fov=half)), look()
    shrunk = near.reshape(-1, SIZE[0] // 2, 2, SIZE[1] // 2, 2, 3).mean((2, 4))
    rows, columns = SIZE[0] // 4, SIZE[1] // 4
    assert difference(shrunk, planned[:, rows : 3 * rows, columns : 3 * columns]) < 0.25 * difference(near, planned)


def test_a_photo_turned_by_a_turn_of_the_agent_shows_the_view_of_the_next_heading(look):
    taken, planned = look(photo=PhotoCamera(aside=90)), look()
    places = planned.reshape(-1, 4, *planned.shape[1:])
    beside = [np.roll(places, turns, 1).reshape(planned.shape) for turns in (-1, 1)]
    assert all(min(difference(view, side[at]) for side in beside) == 0 for at, view in enumerate(taken))


def test_a_portrait_is_higher_than_wide_and_impossible_cameras_are_refused(look):
    assert look(photo=PhotoCamera(portrait=True)).shape[1:3] == SIZE[::-1]
    with pytest.raises(SceneError, match=r"photo\.fov=170: must be 0 to 150"):
        PhotoCamera(fov=170)


def test_a_photo_is_corrected_to_what_the_agents_camera_sees():
    room, size, inside = closet(), (96, 128), np.s_[30:66, 44:84]  # what each of these photos shows
    renderer, pose = Renderer.of(room, fine=False), next(iter(poses(walk(room))))
    planned = renderer.view(room.camera, pose, size).astype(float)

    def off(view):
        return difference(view[inside], planned[inside])

    tilted = renderer.view(room.camera, pose, size, roll=12)
    assert off(as_seen_by(tilted, size, fov=75, own=75, tilt=12)) < 0.2 * off(tilted)
    wide = renderer.view(replace(room.camera, fov=100), pose, size)
    assert off(as_seen_by(wide, size, fov=100, own=75)) < 0.2 * off(wide)
    upright = renderer.view(replace(room.camera, fov=60), pose, size[::-1], roll=8)
    assert off(as_seen_by(upright, size, fov=60, own=75, tilt=8)) < 0.2 * off(tilted)


def test_looks_of_a_corrected_camera_have_the_shape_of_the_views(look):
    photo = {"fov": 64, "portrait": True, "tilt": 8}
    corrected, planned = look(photo=PhotoCamera(**photo, corrected=True)), look()
    assert corrected.shape == planned.shape
    taken = look(photo=PhotoCamera(**photo)).transpose(0, 2, 1, 3)
    assert difference(corrected, planned) < 0.7 * difference(taken, planned)


def test_a_photo_of_an_impossible_camera_is_refused():
    with pytest.raises(ValueError, match="fov=180: a field of view is 1 to 170 degrees"):
        as_seen_by(np.zeros((24, 32, 3), np.uint8), SIZE, fov=180, own=75)


WINDOW = """
[[furniture]]
kind = "window"
wall = "east"
along = 0.8
size = [0.6, 0.1, 0.6]

[[furniture]]
kind = "vase"
at = [0.3, 1.2]
size = [0.2, 0.2, 0.4]

[grid]"""


def later(seed=0, **changes):
    room = closet("[grid]", WINDOW)
    return room, changed_room(room, np.random.default_rng(seed), Changes(**changes))


def test_a_room_without_changes_is_the_same():
    room, changed = later()
    assert replace(changed, grid=room.grid) == room


def test_lamps_are_off_if_there_is_a_window():
    _, dark = later(lamps=1)
    assert dark.materials["lamp"].emit == 0
    only = closet()
    kept = changed_room(only, np.random.default_rng(0), Changes(lamps=1))
    assert kept.materials == only.materials


def test_daylight_differs_from_window_to_window_and_day_to_day():
    brightness = [later(seed, daylight=1)[1].materials["outdoors"].emit for seed in range(4)]
    assert len(set(brightness)) == 4
    assert min(brightness) > 0


def test_a_stool_is_moved_and_all_places_stay_free():
    moves = []
    for seed in range(5):
        room, changed = later(seed, furniture=0.3)
        before, after = (next(piece for piece in one.furniture if piece.kind == "stool") for one in (room, changed))
        moves.append(np.hypot(after.at[0] - before.at[0], after.at[1] - before.at[1]))
        assert {tuple(at) for at in walk(room).places} <= {tuple(at) for at in walk(changed).places}
        assert not check_room(changed)
    assert max(moves) > 0.05


def test_small_things_are_gone():
    room, changed = later(objects=1)
    assert [piece.kind for piece in room.furniture if piece not in changed.furniture] == ["vase"]


@pytest.mark.parametrize("change", [{"lamps": 1}, {"daylight": 1.5}, {"furniture": 0.3}, {"objects": 1}])
def test_each_change_of_the_room_is_seen_and_drawn_once_for_a_look(change):
    views = views_of(closet("[grid]", WINDOW))
    assert difference(views(0, **change), views(0)) > 0.1
    assert np.array_equal(views(0, **change), views(0, **change))


@pytest.mark.parametrize(("option", "largest"), [("position", 1), ("heading", 45), ("vary", 1)])
def test_errors_beyond_what_a_visit_can_be_called_are_refused(option, largest):
    Changes(**{option: largest})
    for value in (-0.1, largest + 0.1):
        with pytest.raises(SceneError, match=rf"^changes.{option}={value:g}: must be 0 to {largest}$"):
            Changes(**{option: value})
