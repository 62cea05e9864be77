"""Virtual views: what another camera would see where the agent stands."""

import numpy as np
import pytest
import torch

from dirl import Navigator
from dirl.agent.navigator import NavigatorError
from dirl.perception.backbones import load_encoder
from dirl.perception.backbones.registry import encode_all
from dirl.perception.backbones.virtual import encode_with_virtual, with_virtual
from dirl.perception.recognition.photo import DESCRIBED, PhotoOdds
from dirl.perception.virtual import VirtualCameras, virtual_views
from dirl.scenes import load_scenes

SIZE = (48, 64)


def picture(fov, heading, pitch):
    """What a camera sees of a world that is coloured by direction, uint8 ``[48, 64, 3]``."""
    height, width = SIZE
    half = np.tan(np.radians(fov / 2))
    x = ((np.arange(width) + 0.5) / width * 2 - 1) * half
    y = ((np.arange(height) + 0.5) / height * 2 - 1) * half * height / width
    right, down = np.meshgrid(x, y)
    a, p = np.radians(heading), np.radians(pitch)
    level, up = np.cos(p) + down * np.sin(p), np.sin(p) - down * np.cos(p)
    east, north = right * np.cos(a) + level * np.sin(a), level * np.cos(a) - right * np.sin(a)
    direction = np.stack([east, north, up], -1)
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    return np.rint(127.5 + 127.5 * np.sin(4 * direction + [0, 1, 2])).astype(np.uint8)


def around(fov, pitch=0.0, heading=0.0):
    """The four views of an agent."""
    return np.stack([picture(fov, heading + turn, pitch) for turn in (0, 90, 180, 270)])


@pytest.mark.parametrize(("fov", "yaw", "pitch"), [(75, 0, 0), (50, 0, -12), (50, 30, -12), (60, -45, 10), (60, 45, 0)])
def test_it_is_what_that_camera_would_have_seen(fov, yaw, pitch):
    found = virtual_views(around(100, pitch), fov=fov, own=100, yaw=yaw, pitch=pitch)
    error = np.abs(found.astype(int) - picture(fov, yaw, pitch))
    assert np.percentile(error, 95) <= 3
    assert error.max() <= 12  # at the seams of the views


def test_a_quarter_turn_shows_the_next_view_and_gaps_show_its_edge():
    views = around(75)
    for quarter, view in enumerate(views):
        turned = virtual_views(views, fov=75, own=75, yaw=90.0 * quarter)
        assert np.abs(turned.astype(int) - view).max() <= 1
    between = virtual_views(views, fov=75, own=75, yaw=45)
    assert np.abs(between[24, 31].astype(int) - views[0][24, -1]).max() <= 4  # at 44 of 37.5 degrees
    many = virtual_views(np.stack([views, views[::-1]]), fov=50, own=75)
    assert (many[0] == virtual_views(views, fov=50, own=75)).all()


def test_cameras_see_around_each_view():
    cameras, views = VirtualCameras(60, (0.0, 45.0), own=75), around(75)
    found = cameras.around(views[None])[0]
    assert found.shape == (4, 2, *SIZE, 3)
    assert (found[1, 1] == virtual_views(np.roll(views, -1, 0), fov=60, own=75, yaw=45)).all()


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"fov": 0}, "fov=0"),
        ({"fov": 171}, "fov=171"),
        ({"own": 0}, "own=0"),
        ({"yaws": ()}, "yaws"),
        ({"pitch": 90}, "90"),
    ],
)
def test_angles_that_no_camera_has_are_refused(wrong, named):
    with pytest.raises(ValueError, match=named):
        VirtualCameras(**{"fov": 50.0, **wrong})


def test_photos_are_compared_with_virtual_views_at_equal_probability():
    torch.manual_seed(0)
    network = PhotoOdds().eval()
    network.measure(torch.randn(10, 48, 96))
    visits, photos = network.describe(torch.randn(5, 4, 3 * 48, 96)), network.describe(torch.randn(2, 48, 96))
    own, *virtual = visits.split(DESCRIBED, -1)
    each = torch.stack([network.scores(part, photos) for part in virtual])
    torch.testing.assert_close(network.scores(visits, photos), each.exp().mean(0).log(), atol=1e-5, rtol=0)
    one = torch.cat([own, virtual[0]], -1)
    torch.testing.assert_close(network.scores(one, photos), each[0], atol=1e-6, rtol=0)


@pytest.fixture(scope="module")
def bathroom():
    """A built-in room, whose cameras look down by 12 degrees, and the views around two of its states."""
    scene = load_scenes("bathroom_02")[0]
    assert scene.views is not None
    return [np.stack([scene.views[seen] for seen in scene.surrounding[state]]) for state in (26, 60)]


CAMERAS = VirtualCameras(50, (0.0,), own=75, pitch=-12)


def test_a_navigator_recognises_a_photo_of_a_narrower_camera(bathroom):
    here, elsewhere = bathroom
    photo = virtual_views(here, fov=50, own=75, pitch=-12)
    chosen = {"recogniser": "learned", "episodic_memory": "localising"}
    plain = Navigator.load("general", "efficientnet_lite0", **chosen)
    virtual = Navigator.load("general", "efficientnet_lite0", virtual=CAMERAS, **chosen)
    odds = []
    for navigator in (plain, virtual):
        for views in bathroom:
            navigator.reset(photo)
            odds.append(navigator.act(views).scores.matching)
    assert odds[0] < 0 < odds[2]
    assert odds[3] < odds[2] - 4
    plain.reset(here)
    virtual.reset(here)
    with_photo = virtual.act(elsewhere).scores.probabilities  # four views are compared as before
    torch.testing.assert_close(with_photo, plain.act(elsewhere).scores.probabilities, atol=1e-4, rtol=0)


def test_a_navigator_compares_a_photo_by_fine_patches(bathroom):
    photo, views = bathroom[0][0], bathroom[1]
    navigator = Navigator.load("general", "efficientnet_lite0", recogniser="learned", episodic_memory="localising")
    navigator.reset(photo)
    found = navigator.act(views).scores.matching
    recogniser = navigator.recogniser
    expected = {}
    for fine in (True, False):
        encoder = load_encoder("efficientnet_lite0", patches=True, fine_patches=fine)
        seen = encode_all(encoder, iter([photo, *views]), 5, "here", progress=False)
        described = recogniser.describe(torch.from_numpy(seen.features), torch.from_numpy(seen.patches))
        expected[fine] = recogniser.scores(described[None, 1:], described[None, :1]).item()
    assert found == pytest.approx(expected[True], abs=0.02)
    assert expected[False] != pytest.approx(expected[True], abs=0.1)


def test_a_map_without_fine_patches_is_not_for_a_navigator_with_them(bathroom, tmp_path):
    chosen = {"recogniser": "learned", "episodic_memory": "localising"}
    loaded = load_encoder("efficientnet_lite0", patches=True)

    def encoder(images):
        pooled, patches = loaded.forward_patches(images)
        return torch.cat([pooled, patches.flatten(1)], 1)

    walk = Navigator.load("general", encoder, extractor=loaded.extractor, **chosen).explore(turns=4)
    walk.see(bathroom[0])
    folder = walk.save(tmp_path / "map")
    fine = Navigator.load("general", "efficientnet_lite0", **chosen)
    with pytest.raises(NavigatorError, match="; fine patches"):
        fine.reset(bathroom[0][0], graph=folder)


def test_maps_with_virtual_views_are_for_navigators_with_the_same_ones(bathroom, tmp_path):
    chosen = {"recogniser": "learned", "episodic_memory": "localising"}
    virtual = Navigator.load("general", "efficientnet_lite0", virtual=CAMERAS, **chosen)
    walk = virtual.explore(turns=4)
    walk.see(bathroom[0])
    folder = walk.save(tmp_path / "map")
    photo = virtual_views(bathroom[0], fov=50, own=75, pitch=-12)
    virtual.reset(photo, graph=folder)
    assert virtual.act(bathroom[0]).scores.matching > 0
    plain = Navigator.load("general", "efficientnet_lite0", **chosen)
    with pytest.raises(NavigatorError, match="virtual views of 50 degrees"):
        plain.reset(photo, graph=folder)


@pytest.mark.parametrize(("encoder", "recogniser"), [("resnet50", "learned"), ("efficientnet_lite0", "ncc")])
def test_what_cannot_compare_virtual_views_is_refused(encoder, recogniser):
    with pytest.raises(NavigatorError, match="virtual cameras"):
        Navigator.load("general", encoder, recogniser=recogniser, episodic_memory="planning", virtual=CAMERAS)


def test_patches_of_virtual_views_follow_those_of_each_view(bathroom):
    encoder = load_encoder("efficientnet_lite0", fine_patches=True)
    surrounding = np.array([np.roll(np.arange(4), -turns) for turns in range(4)])
    found = encode_with_virtual(encoder, bathroom[0].__getitem__, surrounding, CAMERAS, "here", progress=False)
    plain = encode_with_virtual(encoder, bathroom[0].__getitem__, surrounding, None, "here", progress=False)
    assert found.patches is not None
    assert plain.patches is not None
    assert found.patches.shape == (4, 96, 96)
    assert (found.patches[:, :48] == plain.patches).all()
    seen = torch.from_numpy(virtual_views(np.roll(bathroom[0], -2, 0), fov=50, own=75, pitch=-12)[None])
    assert encoder.forward_patches is not None
    expected = encoder.forward_patches(seen)[1][0].numpy()
    np.testing.assert_allclose(found.patches[2, 48:], expected, atol=0.02)
    assert (
        with_virtual(encoder, CAMERAS).patch_attributes["extractor"].endswith("virtual views of 50 degrees at yaws 0")
    )
    assert with_virtual(encoder, None) is encoder
