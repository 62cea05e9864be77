import csv
import os

import h5py
import numpy as np
import pytest
from PIL import Image

from dirl.scenes.graph import AHEAD, BACK
from dirl.scenes.scene import SceneError
from dirl.sources.photos import read_photos
from dirl.sources.recordings import unpack_recording

PLACES, HEADINGS, SHOTS = 6, 4, 2
GRID = [(x, z) for x in range(2) for z in range(3)]


def pictures():
    """Of one colour each, that says place, heading and shot: uint8 ``[place, heading, shot, H, W, 3]``."""
    colours = np.indices((PLACES, HEADINGS, SHOTS)).transpose(1, 2, 3, 0) * (40, 60, 200) + 10
    return np.broadcast_to(colours[:, :, :, None, None], (PLACES, HEADINGS, SHOTS, 8, 12, 3)).astype(np.uint8)


@pytest.fixture
def record(tmp_path):
    def made(images, **datasets):
        with h5py.File(tmp_path / "robot.h5", "w") as file:
            for name, values in {"images": images, **datasets}.items():
                file[name] = values
        return tmp_path / "robot.h5"

    return made


def unpacked(file, **options):
    told = unpack_recording(file, file.parent / "out", images="images", **options)
    return told, *read_photos(file.parent / "out")


def test_axes_in_any_order_give_the_same_scene(record):
    images, at = pictures(), 0.5 * np.array(GRID, float)
    first = unpacked(record(images, at=at), axes=["place", "heading", "shot"], positions="at")
    record(images).parent.joinpath("out").rename(record(images).parent / "first")
    second = unpacked(
        record(images.transpose(2, 1, 0, 3, 4, 5), at=at), axes=["shot", "heading", "place"], positions="at"
    )
    assert first[0].endswith("out: 6 places, 4 headings, shots of a place: 2, images 12x8")
    assert np.array_equal(first[1].graph, second[1].graph)
    assert [file.name for file in first[2]] == [file.name for file in second[2]]
    for place, heading, shot in ((0, 0, 0), (4, 3, 1), (5, 1, 0)):
        file = second[2][shot * 24 + place * 4 + heading]
        assert np.abs(np.asarray(Image.open(file)).astype(int) - images[place, heading, shot]).max() < 12


@pytest.mark.parametrize("clockwise", [True, False])
def test_moves_lead_a_step_in_the_direction_of_the_heading(record, clockwise):
    images = pictures()[:, :, 0]
    file = record(images.reshape(2, 3, HEADINGS, 8, 12, 3))
    _, scene, files = unpacked(file, axes=["x", "z", "heading"], step=0.5, clockwise=clockwise)
    names = {(place, angle): 4 * place + angle // 90 for place in range(PLACES) for angle in (0, 90, 180, 270)}
    assert np.allclose(scene.positions[::4], 0.5 * np.array(GRID))
    for (place, angle), state in names.items():
        assert scene.headings[state] == angle
        heading = (angle if clockwise else -angle) // 90 % 4
        assert np.abs(np.asarray(Image.open(files[state])).astype(int) - images[place, heading]).max() < 12
        x, z = np.add(GRID[place], {0: (0, 1), 90: (1, 0), 180: (0, -1), 270: (-1, 0)}[angle])
        ahead = names[GRID.index((x, z)), angle] if (x, z) in GRID else -1
        assert scene.graph[state, AHEAD] == ahead
        assert ahead < 0 or scene.graph[ahead, BACK] == state


def test_places_without_pictures_are_left_out(record):
    images = pictures()
    images[2] = 0
    file = record(images, at=np.array(GRID, float))
    _, scene, _ = unpacked(file, axes=["place", "heading", "shot"], positions="at")
    assert len(scene) == 20
    with (file.parent / "out" / "states.csv").open() as stream:
        assert "2" not in {row["location"] for row in csv.DictReader(stream)}


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"axes": ["place", "heading"]}, "positions: name the dataset"),
        ({"axes": ["x", "heading", "shot"]}, "expected heading, and place or x and z"),
        ({"axes": ["place", "place", "heading"], "positions": "at"}, "expected each once, of place, x, z"),
        ({"axes": ["place", "heading"], "positions": "at"}, r"images: expected shape"),
        ({"axes": ["heading", "place", "shot"], "positions": "at"}, "images: 6 headings; expected a multiple of four"),
        ({"axes": ["place", "heading", "shot"], "positions": "nowhere"}, "has no dataset 'nowhere'"),
        ({"axes": ["place", "heading", "shot"], "positions": "far"}, "far: holds values that are not finite"),
    ],
)
def test_what_does_not_fit_is_told_in_one_line_and_nothing_stays(record, options, told):
    at = np.array(GRID, float)
    file = record(pictures(), at=at, far=at + np.inf)
    with pytest.raises(SceneError, match=told) as caught:
        unpacked(file, **options)
    assert "\n" not in str(caught.value)
    assert [one.name for one in file.parent.iterdir()] == ["robot.h5"]


def test_a_file_that_is_none_is_told(tmp_path):
    os.mkfifo(tmp_path / "pipe.h5")  # is not waited for
    with pytest.raises(SceneError, match=r"pipe\.h5: there is no such file"):
        unpacked(tmp_path / "pipe.h5", axes=["x", "z", "heading"])
    (tmp_path / "robot.h5").write_text("no")
    with pytest.raises(SceneError, match=r"robot\.h5: not a readable HDF5 file"):
        unpacked(tmp_path / "robot.h5", axes=["x", "z", "heading"])
    with h5py.File(tmp_path / "robot.h5", "w") as file:
        file["frames"] = np.zeros(3)
    with pytest.raises(SceneError, match="there is no dataset 'images'; it has frames"):
        unpacked(tmp_path / "robot.h5", axes=["x", "z", "heading"])


@pytest.mark.parametrize("damage", ["chunk", "end", "group"])
def test_a_damaged_recording_is_one_line_that_names_it_and_nothing_stays(tmp_path, damage):
    file = tmp_path / "robot.h5"
    noise = np.random.default_rng(0).integers(0, 256, (2, 2, 4, 12, 16, 3), np.uint8)
    with h5py.File(file, "w") as made:
        if damage == "group":
            made.create_group("images")
        else:
            made.create_dataset("images", data=noise, chunks=(1, 1, 4, 12, 16, 3), compression="gzip")
    data = bytearray(file.read_bytes())
    if damage == "chunk":
        data[len(data) // 2 : len(data) // 2 + 4000] = bytes(4000)
    file.write_bytes(data[: len(data) // 2] if damage == "end" else data)
    with pytest.raises(SceneError) as caught:
        unpacked(file, axes=["x", "z", "heading"])
    assert "\n" not in str(caught.value)
    assert [one.name for one in tmp_path.iterdir()] == ["robot.h5"]


def test_too_many_images_are_refused_before_one_is_read(tmp_path):
    with h5py.File(tmp_path / "robot.h5", "w") as file:
        file.create_dataset("images", (300, 300, 4, 1, 1, 3), np.uint8, compression="gzip")
    with pytest.raises(SceneError, match="at most 50000 images of 16777216 pixels"):
        unpacked(tmp_path / "robot.h5", axes=["x", "z", "heading"])
