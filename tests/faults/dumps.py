"""Damage thousands of dumps and read each: nothing may crash, hang, print a traceback or pass changed data as good.

    nice python tests/faults/dumps.py count=10000 seed=7

Each file is damaged in one of the ways of damage.py and read in a process that is forked from one that has everything
imported. What crashes or hangs there is read once more as a user reads it, by `read_dump`; so is every fiftieth file.
The same seed damages the same files. The exit status is 1 if a file was not read as it should be; those are listed.
"""

import gc
import hashlib
import signal
import tempfile
import warnings
from contextlib import suppress
from functools import partial
from pathlib import Path

import h5py
import numpy as np
from campaign import conclude, in_a_fork, start
from damage import WAYS
from rooms import grid_scene, published_dump, read_here

from dirl.scenes import SceneError, read_dump, write_dump
from dirl.scenes.io import read as isolation
from dirl.scenes.views import encode

CPU_SECONDS, MEMORY = 1.0, 8 * 2**30
READ_APART = 50
"""Every so many are read as a user's are as well."""

SAME, CHANGED, LINE = "read, and as it was", "read, and changed", "refused with one line"
CRASHED, SLOW = "refused with one line: libhdf5 crashed", "refused with one line: out of time"
SILENT, TRACEBACK, LOST = "CHANGED IN SPITE OF A DIGEST", "TRACEBACK", "NO LINE FROM read_dump"
FAILURES = (SILENT, TRACEBACK, LOST)


def bases(folder):
    """Good files by what they are: with the bytes, and whether a digest protects them."""
    rng = np.random.default_rng(0)
    scene = grid_scene(name="hall", goals=(3, 17))
    views = [encode(rng.integers(0, 256, (12, 16, 3), np.uint8)) for _ in range(24)]
    write_dump(folder / "ours.h5", scene, views, feature_attributes={"extractor": "ResNet-50", "weights": "v2"})
    published_dump(folder / "published.h5", scene, crops=2)
    (folder / "unsigned.h5").write_bytes((folder / "ours.h5").read_bytes())
    with h5py.File(folder / "unsigned.h5", "a") as file:
        del file.attrs["digest"], file["graph"].attrs["digest"]
    return {name: (folder / f"{name}.h5").read_bytes() for name in ("ours", "unsigned", "published")}


def fingerprint(scene):
    """A digest of everything that a scene holds, its views decoded."""
    digest = hashlib.sha256(repr((scene.name, scene.source, scene.extractor, scene.goals)).encode())
    for array in (scene.graph, scene.positions, scene.headings, scene.features):
        digest.update(repr(None if array is None else (array.shape, array.dtype)).encode())
        digest.update(b"" if array is None else array.tobytes())
    for state in range(len(scene) if scene.views else 0):
        view = scene.views[state]
        digest.update(repr(view.shape).encode() + view.tobytes())
    return digest.hexdigest()


def outcome(path, good, protected, *, isolated):
    """What came of reading a file, in this process."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found = fingerprint(read_dump(path) if isolated else read_here(path))
    except SceneError as error:
        return LINE if "\n" not in str(error) and str(error).startswith(f"{path}: ") else TRACEBACK
    except Exception:
        return TRACEBACK
    return SAME if found == good else SILENT if protected else CHANGED


def in_a_limited_fork(read):
    """The outcome that a function gives in a fork with little time and memory."""

    def say():
        signal.setitimer(signal.ITIMER_PROF, CPU_SECONDS)  # its signal ends the process
        yield read()

    found, ended, _ = in_a_fork(say, MEMORY)
    return found[0] if found else SLOW if ended == signal.SIGPROF else CRASHED


def damage(path, content, way, seed):
    """Write a damaged file; what HDF5 itself refuses to write is left as far as it came."""
    path.write_bytes(content)
    with suppress(Exception):
        way(np.random.default_rng(seed), path)


def try_files(numbers, seed, folder):
    """Damage and read files; yields the base, the outcome, the way and the number of each."""
    files, goods, path = bases(folder), {}, folder / "room.h5"  # a file without a name is called by its stem
    for base, content in files.items():
        path.write_bytes(content)
        goods[base] = fingerprint(read_dump(path))
    gc.freeze()  # what is not looked at is not copied in a fork

    def choose(number):
        rng = np.random.default_rng((seed, number))
        return str(rng.choice(list(files))), WAYS[rng.integers(len(WAYS))]

    def read(number, *, isolated=False):
        base, way = choose(number)
        damage(path, files[base], way, (seed, number, 1))
        return outcome(path, goods[base], base == "ours", isolated=isolated)

    for number in numbers:
        found = in_a_limited_fork(partial(read, number))
        if found in (CRASHED, SLOW):
            found = found if read(number, isolated=True) == LINE else LOST
        elif number % READ_APART == 0 and read(number, isolated=True) != found:
            found = LOST
        base, way = choose(number)
        yield base, found, way.__name__, number


def main(count=1000, seed=0):
    """Try ``count`` files; how many went wrong."""
    isolation.SECONDS, isolation.PATIENCE = CPU_SECONDS, 10_000  # the machine may be as busy as it likes
    with tempfile.TemporaryDirectory() as folder:
        return conclude(try_files(range(count), seed, Path(folder)), FAILURES)


if __name__ == "__main__":
    start(main)
