"""Dumps: every layout the published files have is read, changes are noticed, and the published layout is written."""

from dataclasses import replace

import h5py
import numpy as np
import pytest
from malformed import VIEW, views
from refusals import refused
from rooms import grid_scene, read_here

from dirl.scenes import ACTIONS, write_dump
from dirl.scenes.io.hdf5 import compute_digest
from dirl.scenes.io.write import export_icra17
from dirl.scenes.views import encode


def put(path, **datasets):
    """Replace datasets of a file; None removes one."""
    with h5py.File(path, "a") as file:
        for name, value in datasets.items():
            file.pop(name, None)
            if value is not None:
                file[name] = value


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
    other = encode(np.full((6, 8, 3), 50, np.uint8))
    with h5py.File(dump, "a") as file:
        views(other)(file)
    seen = read_here(dump).views
    assert seen[23].shape == (6, 8, 3)
    assert np.abs(seen[23].astype(int) - 50).max() <= 3
    assert (seen.stored(5), seen.stored(23)) == (VIEW, other)


def test_columns_may_be_in_any_declared_order_and_a_file_may_have_any_name(scene, dump):
    order = ("right", "back", "ahead", "left")
    put(dump, graph=scene.graph[:, [ACTIONS.index(action) for action in order]])
    with h5py.File(dump, "a") as file:
        file.attrs["actions"] = np.array(order, "S")
    read = read_here(dump.rename(dump.with_name("a='b#.h5")))
    assert (read.graph == scene.graph).all()
    assert read.name == "a_b"


ABOUT = {"extractor": "ResNet-50", "preprocessing": "/255", "weights": "v2"}


@pytest.fixture
def room(tmp_path):
    rng = np.random.default_rng(0)
    views = [encode(rng.integers(0, 256, (6, 8, 3), np.uint8)) for _ in range(24)]
    scene = grid_scene(name="hall", goals=(3,), patches=True, looks=1)
    write_dump(
        tmp_path / "room.h5", scene, views, feature_attributes=ABOUT, patch_attributes={"projection": "sha256:1"}
    )
    return tmp_path / "room.h5"


def digests(path):
    with h5py.File(path) as file:
        return [file.attrs["digest"], file["graph"].attrs["digest"], compute_digest(file)]


def test_every_writer_leaves_a_digest(room):
    export_icra17(read_here(room), room.with_name("icra17.h5"))
    for path in (room, room.with_name("icra17.h5")):
        assert len(set(digests(path))) == 1
    assert digests(room) != digests(room.with_name("icra17.h5"))


def test_a_change_is_noticed(room):
    """Of a dataset's last value, or of an attribute."""
    whole = room.read_bytes()
    with h5py.File(room) as file:
        names = [*file, "goals", "actions", "source", *ABOUT]
    assert len(names) == 9 + 6
    for name in names:
        room.write_bytes(whole)
        with h5py.File(room, "a") as file:
            if name in file:
                values = file[name][:]
                values.ravel()[-1] += 1
                file[name][...] = values
            else:
                holder = file["resnet_feature"] if name in ABOUT else file
                value = holder.attrs.pop(name)
                holder.attrs[name] = [4] if name == "goals" else value[::-1]
        refused("does not hold what was written to it", read_here, room)


def test_the_digest_is_of_the_values_not_of_how_they_are_stored(room):
    before = digests(room)
    with h5py.File(room, "a") as file:
        file.attrs["note"] = "mine"
        for name in ("location", "resnet_feature"):
            values, about = file[name][:], dict(file[name].attrs)
            del file[name]
            file.create_dataset(name, data=values, compression="gzip", chunks=True).attrs.update(about)
    assert digests(room) == before
    assert read_here(room).name == "hall"


def with_views(folder, scene):
    views = [encode(np.full((60, 80, 3), 3 * state, np.uint8)) for state in range(len(scene))]
    write_dump(folder / "views.h5", scene, views)
    return read_here(folder / "views.h5")


def test_the_layout_is_the_published_one(tmp_path, scene):
    export_icra17(with_views(tmp_path, scene), tmp_path / "out.h5")  # which are scaled
    with h5py.File(tmp_path / "out.h5") as file:
        layout = {name: (dataset.shape, dataset.dtype.str) for name, dataset in file.items()}
        assert layout == {
            "graph": ((24, 4), "<i8"),
            "location": ((24, 2), "<f8"),
            "observation": ((24, 300, 400, 3), "|u1"),
            "resnet_feature": ((24, 10, 16), "<f4"),
            "rotation": ((24,), "<i8"),
            "shortest_path_distance": ((24, 24), "<i8"),
        }
        assert all(dataset.chunks is None for dataset in file.values())
        assert set(np.unique(file["rotation"])) == {0, 90, 180, 270}
        assert (file["graph"][:] == scene.graph).all()
        assert file["graph"][:].min() == -1
        assert (file["resnet_feature"][:] == scene.features[:, None]).all()  # each crop, as public code may draw one
        assert np.abs(file["observation"][:, 150, 200].astype(int) - 3 * np.arange(24)[:, None]).max() <= 3
        assert (file.attrs["source"], file["resnet_feature"].attrs["extractor"]) == ("synthetic", "random")


def test_what_the_layout_cannot_hold_is_refused(tmp_path, scene):
    whole = with_views(tmp_path, scene)
    odd = grid_scene(headings=16)
    odd = replace(odd, views=replace(whole.views, spans=np.zeros((len(odd), 2), int)))
    refused("has no views", export_icra17, replace(whole, views=None), tmp_path / "out.h5")
    refused("has no features .*; encode", export_icra17, replace(whole, features=None), tmp_path / "out.h5")
    refused("rotation: state 1 is headed 22.5 degrees", export_icra17, odd, tmp_path / "out.h5")
    assert not (tmp_path / "out.h5").exists()
