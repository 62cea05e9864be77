"""Reading in another process: the same scenes, and one line if that process comes to grief."""

import subprocess

import numpy as np
import pytest
from malformed import VIEW, make, picture, views
from refusals import refused
from rooms import grid_scene, published_dump, read_here

from dirl.scenes import load_scenes, read_dump, write_dump
from dirl.scenes.io import read as isolation


def packed_views(file):
    pixels = np.random.default_rng(0).integers(0, 256, (24, 3, 4, 3), np.uint8)
    del file["observation"]
    file.create_dataset("observation", data=pixels, compression="gzip", chunks=(5, 3, 4, 3))


@pytest.mark.parametrize("what", ["with looks and patches", "in chunks"])
def test_a_scene_is_the_same(tmp_path, what):
    path = tmp_path / "room.h5"
    if what == "in chunks":
        make(path, packed_views)
    else:
        write_dump(path, grid_scene(feature_width=64, goals=(3, 1), patches=True, looks=2, noise=0.05), [VIEW] * 24)
    apart, here = read_dump(path), read_here(path)
    for name in ("graph", "positions", "headings", "features", "patches", "look_features", "look_patches"):
        ours, theirs = getattr(apart, name), getattr(here, name)
        assert np.array_equal(ours, theirs), name
        assert ours is theirs is None or ours.dtype == theirs.dtype, name
    for name in ("name", "source", "goals", "extractor", "origin"):
        assert getattr(apart, name) == getattr(here, name), name
    for state in range(24):
        assert (apart.views[state] == here.views[state]).all()
        assert apart.views.encoded(state) == here.views.encoded(state)


def test_several_files_are_read_by_one_process_and_the_error_names_the_one(tmp_path, monkeypatch):
    started, popen = [], subprocess.Popen
    monkeypatch.setattr(subprocess, "Popen", lambda *args, **kwargs: started.append(args) or popen(*args, **kwargs))
    paths = [published_dump(tmp_path / f"room{number}.h5", grid_scene(width=1 + number)) for number in range(3)]
    scenes = load_scenes([str(path) for path in paths])
    assert [(scene.name, len(scene)) for scene in scenes] == [("room0", 8), ("room1", 16), ("room2", 24)]
    load_scenes("bathroom_02")  # a built-in room needs none
    assert len(started) == 1
    paths[1].write_bytes(b"")
    refused(r"room1\.h5: not a readable HDF5 file", load_scenes, [str(path) for path in paths])


@pytest.mark.parametrize(
    ("program", "says"),
    [
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", r"libhdf5 failed on it \(SIGSEGV\); it is damaged"),
        ("import sys; sys.stdin.read(); print('half'); sys.exit(7)", r"libhdf5 failed on it \(exit status 7"),
    ],
)
def test_a_process_that_ends_is_one_line(dump, tmp_path, monkeypatch, program, says):
    monkeypatch.setattr(isolation, "PROGRAM", tmp_path / "child.py")
    isolation.PROGRAM.write_text(program)
    refused(rf"^{dump}: {says}", read_dump, dump)


def test_processor_time_is_limited(tmp_path, monkeypatch):
    path = make(tmp_path / "room.h5", views(*[picture("PNG", (4000, 4000), "1")] * 24))  # seconds of decoding
    monkeypatch.setattr(isolation, "SECONDS", 0.1)
    monkeypatch.setattr(isolation, "PATIENCE", 10_000)
    refused(r"room\.h5: was not read after \d+ s of processor time; it is damaged$", read_dump, path)


def test_memory_is_limited(tmp_path, monkeypatch):
    dump = tmp_path / "room.h5"
    write_dump(dump, grid_scene(feature_width=200_000))  # 19 MB: more than the process has left over from its start
    monkeypatch.setattr(isolation, "MEMORY", 2**20)
    refused(f"^{dump}: ", read_dump, dump)


def test_the_clock_limits_it_as_well(dump, tmp_path, monkeypatch):
    monkeypatch.setattr(isolation, "PROGRAM", tmp_path / "child.py")
    isolation.PROGRAM.write_text("import time; time.sleep(1000)")
    monkeypatch.setattr(isolation, "PATIENCE", 0.01)
    refused("was killed: it took too long", read_dump, dump)
