"""Reading in another process: the same scenes, and one line if that process comes to grief."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from commands import wait_until
from malformed import VIEW, make, picture, views
from refusals import refused
from rooms import grid_scene, published_dump, read_here
from tasks import die, fail

from dirl.scenes import load_scenes, read_dump, write_dump
from dirl.scenes.io import read as isolation
from dirl.scenes.io.processes import in_processes
from dirl.scenes.views import encoded_view


def packed_views(file):
    pixels = np.random.default_rng(0).integers(0, 256, (24, 3, 4, 3), np.uint8)
    del file["observation"]
    file.create_dataset("observation", data=pixels, compression="gzip", chunks=(5, 3, 4, 3))


def test_a_scene_is_the_same(tmp_path):
    whole, chunks = tmp_path / "room.h5", make(tmp_path / "chunks.h5", packed_views)
    write_dump(whole, grid_scene(feature_width=64, goals=(3, 1), patches=True, looks=2, noise=0.05), [VIEW] * 24)
    for apart, here in zip(load_scenes([str(whole), str(chunks)]), map(read_here, (whole, chunks)), strict=True):
        for name in ("graph", "positions", "headings", "features", "patches", "look_features", "look_patches"):
            ours, theirs = getattr(apart, name), getattr(here, name)
            assert np.array_equal(ours, theirs), name
            assert ours is theirs is None or ours.dtype == theirs.dtype, name
        for name in ("name", "source", "goals", "extractor", "origin"):
            assert getattr(apart, name) == getattr(here, name), name
        for state in range(24):
            assert (apart.views[state] == here.views[state]).all()
            assert encoded_view(apart.views, state) == encoded_view(here.views, state)


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
    ("program", "patience", "says"),
    [
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", 20, r"libhdf5 failed on it \(SIGSEGV\); it is dam"),
        ("import sys; sys.stdin.read(); print('half'); sys.exit(7)", 20, r"libhdf5 failed on it \(exit status 7"),
        ("import time; time.sleep(1000)", 0.01, "the process that read it was killed: it took too long"),
    ],
)
def test_a_process_that_ends_is_one_line(dump, tmp_path, monkeypatch, program, patience, says):
    monkeypatch.setattr(isolation, "PROGRAM", tmp_path / "child.py")
    monkeypatch.setattr(isolation, "PATIENCE", patience)
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


def test_a_failed_simulator_in_a_process_and_a_killed_process_are_one_line():
    told = r"^VizDoom failed \(RuntimeError: its window is gone\); run the command again$"
    refused(told, list, in_processes([fail], 1, "a test"))
    told = "^rooms: a process was killed, .*; if it happens again, give workers=1$"
    refused(told, list, in_processes([die], 1, "rooms: a process"))


@pytest.mark.skipif(os.name != "posix", reason="elsewhere 0 is a signal that ends a process")
def test_the_processes_of_a_program_that_is_killed_end(tmp_path):
    program, told = tmp_path / "program.py", tmp_path / "told"
    program.write_text(
        "from functools import partial\nfrom tasks import idle\nfrom dirl.scenes.io.processes import in_processes\n"
        f"if __name__ == '__main__':\n    list(in_processes([partial(idle, {str(told)!r})], 1, 'a test'))\n"
    )
    path = os.pathsep.join([str(Path(__file__).parents[2] / "helpers"), *filter(None, sys.path)])
    owner = subprocess.Popen([sys.executable, str(program)], env={**os.environ, "PYTHONPATH": path})
    wait_until(told.exists)
    owner.kill()
    owner.wait()
    with pytest.raises(ProcessLookupError):
        wait_until(lambda: os.kill(int(told.read_text()), 0), patience=60)
