"""Textures and furniture: every kind there is, by what holds for all of them."""

import numpy as np
import pytest
from closet import closet

from dirl.sources.rooms.furniture import FURNITURE, NOT_SOLID
from dirl.sources.rooms.layout import materials_of
from dirl.sources.rooms.mesh import Mesh
from dirl.sources.rooms.textures import TEXTURES, surfaces
from dirl.sources.rooms.textures.noise import Canvas

SIZES = {
    "bed": (1.6, 2.1, 1.1),
    "sofa": (2.0, 0.9, 0.88),
    "counter": (1.4, 0.62, 0.92),
    "plant": (0.5, 0.5, 1.2),
    "door": (0.9, 0.08, 2.0),
}
HIGH = {"wall_cupboard", "hood", "tv", "picture", "mirror", "window", "bottles", "bowl", "vase", "lamp"}
"""Kinds whose height is not measured from the floor."""


@pytest.mark.parametrize("kind", TEXTURES)
def test_a_texture_is_fixed_by_its_seed_and_stays_in_range(kind):
    first, again, other = (TEXTURES[kind](Canvas(np.random.default_rng(seed), 64)) for seed in (0, 0, 1))
    assert first.shape == (64, 64, 3)
    assert (first == again).all()
    assert (first != other).any()
    assert first.min() >= 0
    assert first.max() <= 1
    assert first.std() > 0.004


@pytest.mark.parametrize("kind", [kind for kind, make in TEXTURES.items() if make.__module__ == surfaces.__name__])
def test_a_surface_repeats_without_a_seam(kind):
    texture = TEXTURES[kind](Canvas(np.random.default_rng(0), 128))
    for axis in (0, 1):
        inside = np.abs(np.diff(texture, axis=axis)).mean((1 - axis, 2))
        seam = np.abs(texture.take(0, axis) - texture.take(-1, axis)).mean()
        assert seam <= inside.max() + 0.02


@pytest.mark.parametrize("kind", FURNITURE)
def test_a_piece_is_whole_and_as_large_as_asked(kind):
    w, d, h = SIZES.get(kind, (0.9, 0.6, 0.8))
    parts = FURNITURE[kind](w, d, h).parts
    corners = np.concatenate([part.corners.reshape(-1, 3) for part in parts])
    assert np.isfinite(corners).all()
    for part in parts:
        assert np.allclose(np.linalg.norm(part.normals, axis=-1), 1, atol=1e-6)
    low, high = corners.min(0), corners.max(0)
    spill = 0.35 if kind == "window" else 0.13  # handles, curtains, a duvet that hangs over
    assert (low[:2] >= [-w / 2 - spill, -d / 2 - spill]).all()
    assert (high[:2] <= [w / 2 + spill, d / 2 + spill]).all()
    if kind not in HIGH | {"rug", "ceiling_lamp", "towel_rail", "shower"}:
        assert low[2] == pytest.approx(0, abs=0.03)
        assert high[2] == pytest.approx(h, abs=0.35)


def test_furniture_is_made_of_materials_in_stock_unless_said_otherwise():
    needed = {part.material for make in FURNITURE.values() for part in make(0.9, 0.6, 0.8).parts}
    assert needed - set(materials_of(closet())) == {"art_a", "rug", "shower_curtain"}
    assert set(FURNITURE) >= NOT_SOLID


def test_a_box_is_closed_and_faces_outwards():
    (part,) = Mesh().box(0, 0, 0, 1, 2, 3, "wood", bevel=0.1).parts
    a, b, c = part.corners.transpose(1, 0, 2)
    # The volume by the divergence theorem: it comes out only if no face is missing or turned around.
    volume = (a * np.cross(b, c)).sum() / 6
    assert 6 - 4 * 0.1**2 / 2 * 6 - 0.01 < volume < 6


@pytest.mark.parametrize("make", [
    lambda mesh: mesh.cylinder(0, 0, 0, 1, 0.5, "wood", 64),
    lambda mesh: mesh.tube([(0, 0, 0), (0, 0, 1)], 0.5, "wood", 64),
])  # fmt: skip
def test_a_cylinder_has_its_volume(make):
    (part,) = make(Mesh()).parts
    a, b, c = part.corners.transpose(1, 0, 2)
    assert (a * np.cross(b, c)).sum() / 6 == pytest.approx(np.pi / 4, rel=0.01)


def test_a_moved_part_turns_anticlockwise():
    part = Mesh().quad([(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)], "wood").parts[0].moved((5, 0, 0), 90, 1.0)
    assert part.corners.reshape(-1, 3).max(0).round(9).tolist() == [5, 1, 1]
    assert np.allclose(part.normals[0, 0], [1, 0, 0])
