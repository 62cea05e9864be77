"""Frames compared by their columns: poses in closed form, and what the network of the package tells."""

import numpy as np
import pytest
import torch

from dirl.perception.columns import COLUMNS, UNIT, load_column_net, relative_pose, wall_points


def moved(points, ahead, right, turned):
    """Points as they are seen from a camera that was taken so far, and turned to the left, in degrees."""
    cos, sin = np.cos(np.radians(turned)), np.sin(np.radians(turned))
    return (points - torch.tensor([ahead, right]) / UNIT) @ torch.tensor([[cos, sin], [-sin, cos]]).float()


@pytest.mark.parametrize(
    ("ahead", "right", "turned"), [(0.0, 0.0, 0.0), (80.0, -30.0, 0.0), (20.0, 10.0, 25.0), (-60.0, 40.0, -40.0)]
)
def test_the_pose_of_points_that_match_is_exact_and_few_wrong_matches_change_little(ahead, right, turned):
    generator = torch.Generator().manual_seed(0)
    seen = wall_points(torch.rand(1, COLUMNS, generator=generator))
    other = moved(seen[0], ahead, right, turned)[None]
    matches = torch.eye(COLUMNS)[None]
    score, *pose = (float(value[0]) for value in relative_pose(matches, seen, other))
    assert score == pytest.approx(COLUMNS, abs=0.1)
    assert pose == pytest.approx([ahead, right, turned], abs=0.5)
    matches[0, :4] = matches[0, :4].roll(9, 1)
    pose = [float(value[0]) for value in relative_pose(matches, seen, other)[1:]]
    assert pose == pytest.approx([ahead, right, turned], abs=8)


def test_a_frame_fits_itself_best_where_it_is():
    frames = np.random.default_rng(0).integers(0, 255, (6, 6, 8, 3), dtype=np.uint8).repeat(20, 1).repeat(20, 2)
    net = load_column_net()
    columns = net.describe(frames)
    for frame in range(6):
        seen = columns[frame : frame + 1]
        fit = net.fit(seen, columns, range(6))
        assert fit.score.argmax() == frame == net.likeness(seen, columns).argmax()
        assert np.abs([fit.ahead[frame], fit.right[frame], fit.turned[frame]]).max() < 5


def test_frames_where_one_is_unlikely_to_be_are_as_alike_as_frames_usually_are():
    frames = np.random.default_rng(0).integers(0, 255, (100, 60, 80, 3), dtype=np.uint8)
    net = load_column_net()
    columns = net.describe(frames)
    seen, likely = columns[7:8], np.where(np.arange(100) < 60, 1.0, 0.1)
    found, compared = net.likeness(seen, columns, likely), net.likeness(seen, columns)
    assert found[:60:2] == pytest.approx(compared[:60:2])
    assert found[1:60:2] == pytest.approx(found[:60:2])  # the frame behind one that is compared
    assert len(np.unique(found[60:])) == 1
