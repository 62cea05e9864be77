"""Digests: every writer leaves one, and every change to what means something is noticed."""

import h5py
import numpy as np
import pytest
from refusals import refused
from rooms import grid_scene, read_here

from dirl.scenes import write_dump
from dirl.scenes.io.hdf5 import compute_digest
from dirl.scenes.io.write import export_icra17
from dirl.scenes.views import encode

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


def change_value(file, name):
    """The last bit of a dataset's last value, or another attribute."""
    if name in file:
        values = file[name][:]
        last = values.ravel()[-1]
        if name == "observation_webp":
            last[-1] ^= 1
            file[name][23] = last
        else:
            values.ravel()[-1] = last + 1
            file[name][...] = values
    else:
        holder = file["resnet_feature"] if name in ABOUT else file
        value = holder.attrs.pop(name)
        holder.attrs[name] = [4] if name == "goals" else value[::-1]


VALUES = ["graph", "location", "rotation", "resnet_feature", "patches", "shortest_path_distance", "observation_webp"]
VALUES += ["look_feature", "look_patches"]


def test_a_change_is_noticed(room):
    whole = room.read_bytes()
    for name in (*VALUES, "goals", "actions", "source", *ABOUT):
        room.write_bytes(whole)
        with h5py.File(room, "a") as file:
            change_value(file, name)
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
