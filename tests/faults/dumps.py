"""Damage thousands of dumps and read each: nothing may crash, hang, print a traceback or pass changed data as good.

    nice python tests/faults/dumps.py count=10000 seed=7

Each file is damaged in one of the ways of damage.py and read in a process of its own, forked from one that has
everything imported. What crashes or hangs there is read once more as a user reads it, by `read_dump`, and so is every
fiftieth file. The same seed damages the same files; ``start=5000`` goes on in the middle. The exit status is 1 if a
file was not read as it should be, and the seeds of those are listed.
"""

import gc
import hashlib
import os
import resource
import signal
import sys
import tempfile
import time
import warnings
from collections import Counter
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))

from damage import WAYS
from rooms import grid_scene, published_dump

from dirl.scenes import SceneError, SceneWarning, read_dump, write_dump
from dirl.scenes.io import isolation
from dirl.scenes.views import encode

CPU_SECONDS, MEMORY = 1, 8 * 2**30
READ_APART = 50
"""Every so many files are read in another process as well, as a user's are."""

SAME, CHANGED, LINE = "read, and as it was", "read, and changed", "refused with one line"
CRASHED, SLOW = "refused with one line: libhdf5 crashed", "refused with one line: out of time"
SILENT, TRACEBACK, LOST = "CHANGED IN SPITE OF A DIGEST", "TRACEBACK", "NO LINE FROM read_dump"
FAILURES = (SILENT, TRACEBACK, LOST)
OUTCOMES = (SAME, CHANGED, LINE, CRASHED, SLOW, *FAILURES)


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
            warnings.simplefilter("ignore", SceneWarning)
            found = fingerprint(read_dump(path, isolated=isolated))
    except SceneError as error:
        return LINE if "\n" not in str(error) and str(error).startswith(f"{path}: ") else TRACEBACK
    except Exception:
        return TRACEBACK
    return SAME if found == good else SILENT if protected else CHANGED


def in_a_fork(action):
    """The outcome that a function returns in a forked process with limits, or how that process ended."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        resource.setrlimit(resource.RLIMIT_CPU, (CPU_SECONDS, CPU_SECONDS + 1))
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        try:
            os.write(writing, action().encode())
        finally:
            os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as stream:
        said = stream.read()
    status = os.waitpid(child, 0)[1]
    if said:
        return said
    slow = os.WIFSIGNALED(status) and os.WTERMSIG(status) in (signal.SIGXCPU, signal.SIGKILL)
    return SLOW if slow else CRASHED


def damage(path, content, way, seed):
    """Write a damaged file; what HDF5 itself refuses to write is left as far as it came."""
    path.write_bytes(content)
    with suppress(Exception):
        way(np.random.default_rng(seed), path)


def try_one(number, seed, files, goods, path):
    """Damage and read one file; which base, which way, and the outcome."""
    rng = np.random.default_rng((seed, number))
    base, way = str(rng.choice(list(files))), WAYS[rng.integers(len(WAYS))]
    protected = base == "ours"

    def act():
        damage(path, files[base], way, (seed, number, 1))
        return outcome(path, goods[base], protected, isolated=False)

    found = in_a_fork(act)
    if found in (CRASHED, SLOW) or number % READ_APART == 0:
        apart = outcome(path, goods[base], protected, isolated=True)
        if found in (CRASHED, SLOW):
            found = found if apart == LINE else LOST
        elif apart != found:
            found = LOST
    return base, way.__name__, found


def table(counts, kinds, title):
    """Outcomes by kind, Markdown."""
    lines = [f"| {title} | files | " + " | ".join(OUTCOMES) + " |", "|---|" + "--:|" * (len(OUTCOMES) + 1)]
    for kind in [*kinds, "all"]:
        numbers = [sum(n for (k, o), n in counts.items() if o == what and kind in (k, "all")) for what in OUTCOMES]
        lines.append(f"| {kind} | {sum(numbers)} | " + " | ".join(map(str, numbers)) + " |")
    return "\n".join(lines)


def main(count=1000, seed=0, start=0):
    """Try ``count`` files; print the tables; 1 if something went wrong."""
    isolation.SECONDS = CPU_SECONDS
    began, by_base, by_way, failed = time.monotonic(), Counter(), Counter(), []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = bases(folder)
        goods = {}
        path = folder / "room.h5"  # a file without a name is called by its stem
        for base, content in files.items():
            path.write_bytes(content)
            goods[base] = fingerprint(read_dump(path))
        gc.freeze()  # what is not looked at is not copied in a fork
        for number in range(start, start + count):
            base, way, found = try_one(number, seed, files, goods, path)
            by_base[base, found] += 1
            by_way[way, found] += 1
            if found in FAILURES:
                failed.append(f"{number}: {base}, {way}: {found}")
            if (number + 1) % 500 == 0:
                print(f"{number + 1} files, {time.monotonic() - began:.0f} s", file=sys.stderr, flush=True)
    print(f"{count} files from {start} on, seed {seed}\n")
    print(table(by_base, files, "file"))
    print()
    print(table(by_way, dict.fromkeys(way.__name__ for way in WAYS), "damage"))
    print("\n".join(["", *(failed or ["no failures"])]))
    return bool(failed)


if __name__ == "__main__":
    sys.exit(main(**{key: int(value) for key, value in (argument.split("=") for argument in sys.argv[1:])}))
