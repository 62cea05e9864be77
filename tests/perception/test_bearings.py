"""Where another panorama was taken, by points that both see."""

import numpy as np
import pytest
import torch

from dirl.perception.bearings import FIELD_OF_VIEW, SIZE, support, toward
from dirl.perception.matching import POINTS, SCALE, Described

PLACES = np.array([[0.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
"""Where panoramas were taken, metres to the right and ahead: the second half right of ahead of the first."""
YAWS = np.array([[0.0, 90, 180, 270], [30.0, 120, 210, 300], [0.0, 90, 180, 270]])
ARROWS = np.array([[45.0, 135, np.nan, 225], [225.0, 315, np.nan, np.nan], [0.0, 90, np.nan, np.nan]])


class Points:
    """Finds the projections of points around the first two panoramas; those of the third look like none of them."""

    def describe(self, views):
        assert len(list(views)) == YAWS.size
        rng = np.random.default_rng(0)
        points = rng.uniform((-5, 1.5, -1.5), (5, 5, 1.5), (600, 3))  # none behind, so that one photo is of nothing
        vectors = rng.normal(size=(2, 600, 64))
        vectors /= np.linalg.norm(vectors, axis=-1, keepdims=True)
        focal = SIZE / 2 / np.tan(np.radians(FIELD_OF_VIEW / 2))
        count = YAWS.size
        none = np.zeros((count, POINTS, 2), np.float16), np.zeros((count, POINTS, 64), np.int8)
        found = Described(rng.normal(size=(count, 8)).astype(np.float16), *none, np.zeros(count, np.int16))
        for view, yaw in enumerate(np.radians(YAWS.ravel())):
            seen = points - [*PLACES[view // 4], 0]
            right = seen[:, 0] * np.cos(yaw) - seen[:, 1] * np.sin(yaw)
            depth = seen[:, 0] * np.sin(yaw) + seen[:, 1] * np.cos(yaw)
            at = np.stack([right, -seen[:, 2]], 1) / np.maximum(depth, 1e-3)[:, None] * focal + SIZE / 2
            shown = np.flatnonzero((depth > 0.3) & (at > 0).all(1) & (at < SIZE).all(1))[:POINTS]
            found.positions[view, : len(shown)] = at[shown]
            found.vectors[view, : len(shown)] = np.rint(vectors[view // 8, shown] * SCALE).clip(-127, 127)
            found.counts[view] = len(shown)
        return found


def test_a_match_agrees_where_both_see_it_on_the_same_side_and_the_second_farther_back():
    def agrees(there):  # along the way, and turned by nothing
        elevation = np.arctan(np.tan(0.2) * np.sin(there) / np.sin(0.5))  # so that both see the same height
        matched = torch.tensor([[0.5, 0.2]]), torch.tensor([[there, elevation]], dtype=torch.float32)
        return bool(support(*matched, torch.tensor([0]), 1)[0, 0, 0])

    assert [agrees(there) for there in (1.0, 0.3, -3.0)] == [True, False, False]


@pytest.fixture(scope="module")
def table():
    return np.stack(list(toward(Points(), [None] * YAWS.size, YAWS, ARROWS)), 1).reshape(2, 3, 4, 3, 4)


def test_the_arrow_to_another_panorama_is_clear_and_no_other(table):
    """However the other one is turned, and whichever of its headings is the goal; a photo tells less."""
    four = torch.from_numpy(table[0].astype(np.float32))
    assert four[0, 0, 1].min() > 0.9
    assert four[1, 0, 0].min() > 0.9
    assert four[0, 1:, 1].max() == 0
    assert four[1, 1:, 0].max() == 0
    photo = table[1, 0, 0, 1].astype(float)
    assert photo.max() > 0.5
    assert photo.min() == 0


def test_where_nothing_is_shared_nothing_is_told(table):
    assert not table[:, 2].any()
    assert not table[:, :, :, 2].any()
    assert not table[:, [0, 1], :, [0, 1]].any(), "an arrow does not lead to where it begins"
