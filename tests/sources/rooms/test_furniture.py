"""Textures and furniture: every kind there is, by what holds for all of them."""

import numpy as np
import pytest
from closet import closet

from dirl.sources.rooms.furniture import FURNITURE
from dirl.sources.rooms.layout import materials_of
from dirl.sources.rooms.textures import TEXTURES, surfaces
from dirl.sources.rooms.textures.noise import Canvas

SIZES = {"bed": (1.6, 2.1, 1.1), "sofa": (2.0, 0.9, 0.88), "counter": (1.4, 0.62, 0.92)}
SIZES |= {"plant": (0.5, 0.5, 1.2), "door": (0.9, 0.08, 2.0)}
HIGH = {"wall_cupboard", "hood", "tv", "picture", "mirror", "window", "bottles", "bowl", "vase", "lamp"}
"""Kinds whose height is not measured from the floor."""


@pytest.mark.parametrize("kind", TEXTURES)
def test_a_texture_is_fixed_by_its_seed_stays_in_range_and_repeats_without_a_seam(kind):
    first, again, other = (TEXTURES[kind](Canvas(np.random.default_rng(seed), 128)) for seed in (0, 0, 1))
    assert first.shape == (128, 128, 3)
    assert (first == again).all()
    assert (first != other).any()
    assert first.min() >= 0
    assert first.max() <= 1
    assert first.std() > 0.004
    for axis in (0, 1) if TEXTURES[kind].__module__ == surfaces.__name__ else ():
        inside = np.abs(np.diff(first, axis=axis)).mean((1 - axis, 2))
        seam = np.abs(first.take(0, axis) - first.take(-1, axis)).mean()
        assert seam <= inside.max() + 0.02


@pytest.mark.parametrize("kind", FURNITURE)
def test_a_piece_is_whole_and_as_large_as_asked(kind):
    w, d, h = SIZES.get(kind, (0.9, 0.6, 0.8))
    parts = FURNITURE[kind](w, d, h).parts
    stock = {*materials_of(closet()), "art_a", "rug", "shower_curtain"}
    assert {part.material for part in parts} <= stock
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
