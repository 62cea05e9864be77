"""What the campaigns share: their command lines, forks with limits, files to work on, and counts of outcomes."""

import os
import resource
import shutil
import sys
import tempfile
from collections import Counter
from contextlib import contextmanager
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))
sys.path.insert(0, str(Path(__file__).parents[2] / "recipes"))

import numpy as np
from commands import SHORT
from forks import run
from PIL import Image
from rooms import grid_scene
from tours import written

from dirl.scenes import write_dump
from dirl.scenes.views import encode


def start(main):
    """Run a campaign with the numbers of its command line, ``count=100 seed=1``; the exit status is 1 if any failed."""
    failed = main(**{key: int(value) for key, value in (argument.split("=") for argument in sys.argv[1:])})
    print(f"\n{failed} failed")
    sys.exit(bool(failed))


def conclude(cases, failures):
    """Print the cases that failed, and how often each kind had each outcome; how many failed.

    Args:
        cases: of each case its kind, its outcome, and what it was.
        failures: the outcomes that must not be.
    """
    counts = Counter()
    for kind, outcome, *what in cases:
        counts[kind, outcome] += 1
        if outcome in failures:
            print(f"{kind}, {outcome}:", *what, flush=True)
    for (kind, outcome), number in sorted(counts.items()):
        print(f"{kind}, {outcome}: {number}")
    return sum(number for (_, outcome), number in counts.items() if outcome in failures)


def in_a_fork(say, memory):
    """The lines that a generator yields in a fork of so many bytes, the signal that ended it (0: none), its seconds."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        try:
            for line in say():
                os.write(writing, f"{line}\n".encode())
        finally:
            os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as stream:
        said = stream.read().splitlines()
    _, status, usage = os.wait4(child, 0)
    return said, os.WTERMSIG(status), usage.ru_utime + usage.ru_stime


@contextmanager
def work():
    """A folder with ``room.h5``, photographs, a tour, a map of a walk, and a finished run; it is removed at the end."""
    folder = Path(tempfile.mkdtemp())  # a TemporaryDirectory would be removed at the end of the first fork
    try:
        rng = np.random.default_rng(0)
        views = [encode(rng.integers(0, 256, (12, 16, 3), np.uint8)) for _ in range(24)]
        write_dump(folder / "room.h5", grid_scene(goals=(0, 13), feature_width=32), views)
        written("pannellum", folder / "tour")
        (folder / "photos").mkdir()
        rows = ["image,location,heading,x,z,ahead"]
        for state in range(8):
            Image.fromarray(rng.integers(0, 256, (24, 32, 3), np.uint8)).save(folder / "photos" / f"{state}.png")
            ahead = "" if state else "1"
            rows.append(f"{state}.png,{state // 4},{state % 4 * 90},{state // 4},0,{ahead}")
        (folder / "photos" / "states.csv").write_text("\n".join([*rows, ""]))
        (folder / "walk").mkdir()
        wall = Image.fromarray(rng.integers(0, 256, (12, 40), np.uint8)).resize((640, 192), Image.Resampling.BICUBIC)
        for frame in range(8):  # which passes by, a bit each time
            wall.crop((32 * frame, 0, 32 * frame + 256, 192)).save(folder / "walk" / f"{frame}.png")
        options = {
            "train": [f"scene={folder / 'room.h5'}", *SHORT, "hydra.run.dir=runs/fast/0"],
            "map": ["video=walk", "out=walk.pt"],
        }
        for recipe, given in options.items():
            ended = run(folder, recipe, *given)
            assert ended.status == 0, ended.errors
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
