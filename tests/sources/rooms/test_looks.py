"""Further looks of a room: the errors of its visits."""

import numpy as np
import pytest
from closet import closet

pytest.importorskip("embreex")

from dirl.sources.rooms.build import Changes, look_views
from dirl.sources.rooms.navigation import walk
from dirl.sources.rooms.view import Renderer


def test_each_error_changes_the_views_and_more_of_it_more():
    room = closet()
    way, renderer = walk(room), Renderer.of(room, fine=False)

    def look(seed=0, **changes):
        made = Changes(**{"position": 0, "heading": 0, "exposure": 0, **changes})
        return np.stack(list(look_views(renderer, room.camera, way, (24, 32), made, seed))).astype(float)

    planned = look()
    assert np.array_equal(look(seed=1), planned)
    for name, size in {"position": 0.05, "heading": 5, "exposure": 0.2}.items():
        some = look(**{name: size})
        assert 0.3 < np.abs(some - planned).mean() < np.abs(look(**{name: 3 * size}) - planned).mean()
        assert np.array_equal(look(**{name: size}), some)
        assert not np.array_equal(look(seed=1, **{name: size}), some)
    # `some` is the one of other exposures: that of a place is of all its views.
    brightness = (some.mean((1, 2, 3)) / planned.mean((1, 2, 3))).reshape(-1, 4)
    assert brightness.std(1).max() < 0.05
    assert brightness.mean(1).std() > 0.05
