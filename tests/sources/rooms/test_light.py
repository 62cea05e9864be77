"""Light, where the answer is known beforehand."""

import numpy as np
import pytest

pytest.importorskip("embreex")

from dirl.sources.rooms.description import Material
from dirl.sources.rooms.light import direct_light, standpoints
from dirl.sources.rooms.mesh import Mesh
from dirl.sources.rooms.scenery import Scenery

WHITE = Material("plain", {"color": "#ffffff", "var": 0.0}, rough=1.0, emit=2.0, resolution=8)


def test_in_a_cube_that_shines_all_over_the_light_is_pi_times_the_radiance():
    s, mesh = 2.0, Mesh()
    for side in (
        [(0, s, 0), (s, s, 0), (s, s, s), (0, s, s)],
        [(s, 0, 0), (0, 0, 0), (0, 0, s), (s, 0, s)],
        [(s, s, 0), (s, 0, 0), (s, 0, s), (s, s, s)],
        [(0, 0, 0), (0, s, 0), (0, s, s), (0, 0, s)],
        [(0, 0, 0), (s, 0, 0), (s, s, 0), (0, s, 0)],
        [(0, 0, s), (0, s, s), (s, s, s), (s, 0, s)],
    ):
        mesh.quad(side, "white")
    cube = Scenery([part.moved((0, 0, 0), 0, 1.0) for part in mesh.parts], {"white": WHITE}, edge=0.4)
    origins, normals = standpoints(cube)
    inside = ((origins > 0.3) & (origins < 1.7)).sum(1) == 2  # corners are darkened on purpose, to tame lamps there
    light = direct_light(cube, origins, normals, 400, np.random.default_rng(0))[inside]
    assert np.allclose(light.mean(), np.pi * 2.0, rtol=0.04)
    assert light.std() < 0.1 * light.mean()
