"""Light and views, where the answer is known beforehand."""

import numpy as np
import pytest

pytest.importorskip("embreex")

from dirl.sources.rooms.description import Material
from dirl.sources.rooms.light import direct_light, standpoints
from dirl.sources.rooms.mesh import Mesh
from dirl.sources.rooms.scenery import Scenery
from dirl.sources.rooms.view import Renderer

GREY = Material("plain", {"color": "#bcbcbc", "var": 0.0}, rough=1.0, resolution=8)  # half of the light, linearly
RED = Material("plain", {"color": "#ff0000", "var": 0.0}, rough=1.0, resolution=8)
BLUE = Material("plain", {"color": "#0000ff", "var": 0.0}, rough=1.0, resolution=8)
WHITE = Material("plain", {"color": "#ffffff", "var": 0.0}, rough=1.0, emit=2.0, resolution=8)


def furnace(materials, names="nsewfc", side=2.0):
    """A closed cube seen from inside; the material of each side: north, south, east, west, floor, ceiling."""
    s, mesh = side, Mesh()
    corners = {
        "n": [(0, s, 0), (s, s, 0), (s, s, s), (0, s, s)],
        "s": [(s, 0, 0), (0, 0, 0), (0, 0, s), (s, 0, s)],
        "e": [(s, s, 0), (s, 0, 0), (s, 0, s), (s, s, s)],
        "w": [(0, 0, 0), (0, s, 0), (0, s, s), (0, 0, s)],
        "f": [(0, 0, 0), (s, 0, 0), (s, s, 0), (0, s, 0)],
        "c": [(0, 0, s), (0, s, s), (s, s, s), (s, 0, s)],
    }
    for name, points in zip(names, corners.values(), strict=True):
        mesh.quad(points, name)
    return Scenery([part.moved((0, 0, 0), 0, 1.0) for part in mesh.parts], materials, edge=0.4)


def test_in_a_cube_that_shines_all_over_the_light_is_pi_times_the_radiance():
    cube = furnace({"a": WHITE}, "aaaaaa")
    origins, normals = standpoints(cube)
    inside = ((origins > 0.3) & (origins < 1.7)).sum(1) == 2  # corners are darkened on purpose, to tame lamps there
    light = direct_light(cube, origins, normals, 400, np.random.default_rng(0))[inside]
    assert np.allclose(light.mean(), np.pi * 2.0, rtol=0.04)
    assert light.std() < 0.1 * light.mean()


def test_a_panorama_shows_all_directions():
    cube = furnace({"r": RED, "b": BLUE, "g": GREY}, "rbgggg")
    renderer = Renderer(cube, np.ones((len(cube.point_corner), 3), np.float32))
    north = renderer.panorama(1.0, (1.0, 1.0, 0.0), (16, 32))
    assert north[8, 16].tolist()[1:] == [0, 0]  # in the middle it looks to the north, which is red
    assert north[8, 0].tolist()[:2] == north[8, 31].tolist()[:2] == [0, 0]  # at both edges to the south, which is blue
    assert min(*north[0, 16], *north[15, 16], *north[8, 8], *north[8, 24]) > 100
    east = renderer.panorama(1.0, (1.0, 1.0, 90.0), (16, 32))
    assert (east == np.roll(north, -8, 1)).mean() > 0.95
