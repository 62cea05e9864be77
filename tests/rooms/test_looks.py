"""Further looks of a room: the errors of its visits."""

import numpy as np
import pytest
from closet import closet

pytest.importorskip("embreex")

from dirl.rooms.looks import Changes, look_views
from dirl.rooms.navigation import walk
from dirl.rooms.view import Renderer
from dirl.scenes import SceneError

SIZE = (24, 32)


@pytest.fixture(scope="module")
def look():
    room = closet()
    way, renderer = walk(room), Renderer.of(room, fine=False)
    none = {"position": 0, "heading": 0, "exposure": 0}

    def views(seed=0, **changes):
        made = Changes(**{**none, **changes})
        return np.stack(list(look_views(renderer, room, way, SIZE, made, seed, fine=False))).astype(float)

    return views


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


@pytest.mark.parametrize(("option", "largest"), [("position", 1), ("heading", 45), ("vary", 1)])
def test_errors_beyond_what_a_visit_can_be_called_are_refused(option, largest):
    Changes(**{option: largest})
    for value in (-0.1, largest + 0.1):
        with pytest.raises(SceneError, match=rf"^changes.{option}={value:g}: must be 0 to {largest}$"):
            Changes(**{option: value})
