import pytest
from rooms import grid_scene

from dirl.scenes import make_world


@pytest.fixture
def world():
    """24 states with goals 0 and 13, 12 around a corner with goal 30, 8 in two unconnected places with goal 37."""
    room = grid_scene(3, 2, name="room", goals=(0, 13))
    corner = grid_scene(2, 2, name="corner", goals=(6,), blocked=[(1, 1)], seed=1)
    split = grid_scene(3, 1, name="split", goals=(1,), blocked=[(1, 0)], seed=2)
    return make_world([room, corner, split])
