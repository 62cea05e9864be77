"""Where agents can stand and go in a room, against slow and plain ways of finding out."""

import numpy as np
import pytest
from closet import closet
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused

from dirl.scenes.graph import AHEAD, BACK
from dirl.sources.rooms.dump import scene_of
from dirl.sources.rooms.walkable import clearance, walk

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
