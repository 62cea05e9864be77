"""Further looks of a room: the errors of its visits."""

import numpy as np
import pytest
from closet import closet

pytest.importorskip("embreex")

from dirl.scenes import SceneError
from dirl.sources.rooms.looks import Changes, look_views
from dirl.sources.rooms.navigation import walk
from dirl.sources.rooms.view import Renderer


@pytest.fixture(scope="module")
def look():
    """What gives the views of a look of the room: without errors, but for those that are asked for."""
    room = closet()
    way, renderer = walk(room), Renderer.of(room, fine=False)

    def views(seed=0, **changes):
        made = Changes(**{"position": 0, "heading": 0, "exposure": 0, **changes})
        return np.stack(list(look_views(renderer, room.camera, way, (24, 32), made, seed))).astype(float)

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


@pytest.mark.parametrize(("option", "largest"), [("position", 1), ("heading", 45)])
def test_errors_beyond_what_a_visit_can_be_called_are_refused(option, largest):
    Changes(**{option: largest})
    for value in (-0.1, largest + 0.1):
        with pytest.raises(SceneError, match=rf"^changes.{option}={value:g}: must be 0 to {largest}$"):
            Changes(**{option: value})
