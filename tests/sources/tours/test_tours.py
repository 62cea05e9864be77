"""Tours of a room that is known exactly: all four kinds are read back as the room's graph, headings and views."""

from functools import partial

import numpy as np
import pytest
from closet import closet
from PIL import Image
from refusals import refused
from tours import WRITERS, Camera360, room_truth, turned, write_krpano, write_pannellum

from dirl.scenes.views import decode
from dirl.sources.rooms.walkable import walk
from dirl.sources.tours import read_tour
from dirl.sources.tours.conversion import tour_scene
from dirl.sources.tours.pixels import cut_views, read_panorama, six_images

KINDS = {
    **WRITERS,
    **{f"krpano_{image}": partial(write_krpano, image=image) for image in ("multires", "level", "sphere")},
    **{f"pannellum_{image}": partial(write_pannellum, image=image) for image in ("cubemap", "multires")},
}
SIZE, FOV = (24, 32), 75.0


@pytest.fixture(scope="module")
def camera():
    pytest.importorskip("embreex")
    return Camera360(closet())


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_read_back_as_the_room(kind, camera, tmp_path):
    truth = turned(room_truth(), 0.5)
    tour = read_tour(KINDS[kind](tmp_path, truth, camera))
    assert len(tour.panoramas) == 5
    made = tour_scene(tour, headings=8)
    looks = (truth.middles[:, None] + made.yaws) % 360
    shift = round(looks[0, 0] / 45)  # the zero of the map is not known: by it the numbers of headings differ
    states = (8 * np.arange(5)[:, None] + (np.arange(8) + shift) % 8).ravel()
    expected = np.append(np.argsort(states), -1)[walk(closet(), 45).graph[states]]
    assert (made.scene.graph == expected).all()
    off = (looks - 45 * ((np.arange(8) + shift) % 8) + 180) % 360 - 180
    assert np.abs(off).max() < 1
    assert np.allclose(np.diff(made.scene.headings.reshape(5, 8)[:, :2]) % 360, 45)
    images = [panorama.image for panorama in tour.panoramas]
    views = [decode(view) for view in cut_views(images[:1], made.yaws[:1], size=SIZE, field_of_view=FOV)]
    for heading in (0, 1, 6):
        seen = camera.view(truth.places[0], truth.middles[0] + made.yaws[0, heading], SIZE, FOV)
        error = np.abs(views[heading].astype(float) - seen)
        assert error.mean() < 6, heading
        other = camera.view(truth.places[0], truth.middles[0] + made.yaws[0, heading] + 12, SIZE, FOV)
        assert np.abs(views[heading].astype(float) - other).mean() > 2 * error.mean(), heading


def test_faces_of_a_cube_that_differ_in_size_are_refused(tmp_path):
    for face in "frblud":
        side = 16 if face == "d" else 8
        Image.new("RGB", (side, side)).save(tmp_path / f"{face}.png")
    cube = six_images(lambda face: tmp_path / f"{face}.png")
    refused(r"f\.png: the faces of this cube differ in size", read_panorama, cube, 4.0)
