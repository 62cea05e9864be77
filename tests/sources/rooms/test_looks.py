"""Further looks of a room: the errors of its visits, and what is another day's."""

from dataclasses import replace

import numpy as np
import pytest
from closet import closet

pytest.importorskip("embreex")

from dirl.scenes import SceneError
from dirl.sources.rooms.checks import check_room
from dirl.sources.rooms.looks import Changes, changed_room, look_views
from dirl.sources.rooms.navigation import walk
from dirl.sources.rooms.view import Renderer

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

ROOM = closet("[grid]", WINDOW)


@pytest.fixture(scope="module")
def look():
    """What gives the views of a look of the room: without errors, but for those that are asked for."""
    way, renderer = walk(ROOM), Renderer.of(ROOM, fine=False)

    def views(seed=0, **changes):
        made = Changes(**{"position": 0, "heading": 0, "exposure": 0, **changes})
        return np.stack(list(look_views(renderer, ROOM, way, (24, 32), made, seed, fine=False))).astype(float)

    return views


def difference(one, other):
    return np.abs(one - other).mean()


@pytest.mark.parametrize(
    "change", [{"position": 0.05}, {"heading": 5}, {"exposure": 0.2}, {"white_balance": 0.2}, {"camera_height": 0.1}]
)
def test_each_error_changes_the_views_and_more_of_it_more(look, change):
    (name, size), planned = *change.items(), look()
    some = look(**change)
    assert 0.3 < difference(some, planned) < difference(look(**{name: 3 * size}), planned)
    assert np.array_equal(look(**change), some)
    assert not np.array_equal(look(seed=1, **change), some)


def test_without_errors_every_look_is_the_same_and_views_of_a_place_share_their_exposure(look):
    planned = look()
    assert np.array_equal(look(seed=1), planned)
    brightness = (look(exposure=0.2).mean((1, 2, 3)) / planned.mean((1, 2, 3))).reshape(-1, 4)
    assert brightness.std(1).max() < 0.05
    assert brightness.mean(1).std() > 0.05


def test_errors_that_vary_are_of_another_size_in_each_look(look):
    planned = look()
    alike, varied = (
        [difference(look(seed, heading=5, vary=vary), planned) for seed in range(6)] for vary in (0.0, 0.9)
    )
    assert np.std(varied) > 2 * np.std(alike)


def later(seed=0, **changes):
    return changed_room(ROOM, np.random.default_rng(seed), Changes(**changes))


def test_lamps_daylight_and_small_things_differ_from_day_to_day():
    assert replace(later(), grid=ROOM.grid) == ROOM
    assert later(lamps=1).materials["lamp"].emit == 0
    only = closet()  # without a window a room keeps its light
    assert changed_room(only, np.random.default_rng(0), Changes(lamps=1)).materials == only.materials
    brightness = [later(seed, daylight=1).materials["outdoors"].emit for seed in range(4)]
    assert len(set(brightness)) == 4
    assert min(brightness) > 0
    kept = later(objects=1).furniture
    assert [piece.kind for piece in ROOM.furniture if piece not in kept] == ["vase"]


def test_a_stool_is_moved_and_all_places_stay_free():
    moves = []
    for seed in range(5):
        changed = later(seed, furniture=0.3)
        before, after = (next(piece for piece in one.furniture if piece.kind == "stool") for one in (ROOM, changed))
        moves.append(np.hypot(after.at[0] - before.at[0], after.at[1] - before.at[1]))
        assert {tuple(at) for at in walk(ROOM).places} <= {tuple(at) for at in walk(changed).places}
        assert not check_room(changed)
    assert max(moves) > 0.05


def test_a_change_of_the_room_is_seen_and_drawn_once_for_a_look(look):
    assert difference(look(daylight=1.5), look()) > 0.1
    assert np.array_equal(look(daylight=1.5), look(daylight=1.5))


@pytest.mark.parametrize(("option", "largest"), [("position", 1), ("heading", 45)])
def test_errors_beyond_what_a_visit_can_be_called_are_refused(option, largest):
    Changes(**{option: largest})
    for value in (-0.1, largest + 0.1):
        with pytest.raises(SceneError, match=rf"^changes.{option}={value:g}: must be 0 to {largest}$"):
            Changes(**{option: value})
