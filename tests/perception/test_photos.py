"""Which view shows the same point as a photo of another camera."""

import sys

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from dirl.perception.photos import agreeing_points, as_seen_by


@pytest.fixture(scope="module")
def views():
    """Three pictures of nothing in particular, and one without any points."""
    noise = gaussian_filter(np.random.default_rng(0).uniform(0, 1, (3, 120, 160, 3)), (0, 2, 2, 0))
    pictures = (255 * (noise - noise.min()) / np.ptp(noise)).astype(np.uint8)
    return [*pictures, np.full((120, 160, 3), 128, np.uint8)]


def test_the_view_of_the_same_point_has_most_points_that_agree(views):
    pytest.importorskip("cv2")
    photo = as_seen_by(views[1], (120, 160), fov=75, own=60, tilt=10)  # another lens, and tilted
    counts = agreeing_points(photo, views)
    assert counts[1] > 20 > 2 * max(counts[0], counts[2])
    assert counts[3] == 0
    assert agreeing_points(views[3], views).tolist() == [0, 0, 0, 0]
    assert len(agreeing_points(photo, [])) == 0


def test_without_opencv_the_extra_is_named(views, monkeypatch):
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(ImportError, match=r"pip install 'dirl\[sift\]'"):
        agreeing_points(views[0], views)
