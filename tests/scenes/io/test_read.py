"""Reading and writing dumps: every layout the published files and their descendants have."""

import h5py
import numpy as np
import pytest
from rooms import read_here

from dirl.scenes import ACTIONS
from dirl.scenes.views import encode


def put(path, **datasets):
    """Replace datasets of a file; None removes one."""
    with h5py.File(path, "a") as file:
        for name, value in datasets.items():
            file.pop(name, None)
            if value is not None:
                file[name] = value


def picture(state, height=6, width=8):
    return np.full((height, width, 3), 10 * state, np.uint8)


@pytest.mark.parametrize(("dtype", "crops"), [("f2", None), ("f4", 10), ("f8", 1)])
def test_features_are_those_of_the_first_crop(dump, dtype, crops):
    stored = np.random.default_rng(1).random((24, crops or 1, 2048)).astype(dtype)
    put(dump, resnet_feature=stored if crops else stored[:, 0])
    read = read_here(dump)
    assert read.features.dtype == ("f2" if dtype == "f2" else "f4")
    assert (read.features == stored[:, 0].astype(read.features.dtype)).all()


def test_a_dump_may_lack_features_images_and_distances(dump):
    put(dump, resnet_feature=None, observation=None, shortest_path_distance=None)
    read = read_here(dump)
    assert read.features is None
    assert read.views is None
    assert read.extractor == "none"
    assert read.distances[0, 4] == 3  # the next place to the right: turn, ahead, turn back


def test_numbers_may_be_of_any_type_and_in_compressed_chunks(scene, dump):
    values = {"location": (2 * scene.positions).astype("f2"), "rotation": scene.headings.astype("f2")}
    put(dump, **values, shortest_path_distance=np.zeros((24, 24), "f2"), graph=None)  # distances are never used
    with h5py.File(dump, "a") as file:
        file.create_dataset("graph", data=scene.graph.astype("i8"), compression="gzip", shuffle=True, chunks=True)
    read = read_here(dump)
    assert (read.graph == scene.graph).all()
    assert (read.distances == scene.distances).all()
    assert (read.name, read.source, read.extractor, read.goals) == ("room", "unlabelled", "unknown", ())
    assert read.origin == str(dump)
    assert (read.positions == 2 * scene.positions).all()
    assert (read.headings == scene.headings).all()


def test_encoded_images_are_seen_and_go_before_raw_ones(dump):
    with h5py.File(dump, "a") as file:
        stored = file.create_dataset("observation_webp", (24,), h5py.vlen_dtype(np.uint8))
        for state in range(24):
            stored[state] = np.frombuffer(encode(picture(state)), np.uint8)
    views = read_here(dump).views
    assert views[5].shape == (6, 8, 3)
    assert np.abs(views[5].astype(int) - picture(5)).max() <= 3
    assert views.encoded(5) == encode(picture(5))


def test_columns_may_be_in_any_declared_order(scene, dump):
    order = ("right", "back", "ahead", "left")
    put(dump, graph=scene.graph[:, [ACTIONS.index(action) for action in order]])
    with h5py.File(dump, "a") as file:
        file.attrs["actions"] = np.array(order, "S")
    assert (read_here(dump).graph == scene.graph).all()


def test_a_file_may_have_any_name(dump):
    assert read_here(dump.rename(dump.with_name("a='b#.h5"))).name == "a_b"
