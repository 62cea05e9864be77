"""Start the recipes with hundreds of odd options: nothing may end in a traceback, in several lines, or hang.

    nice python tests/faults/options.py count=500 seed=1

Each case is a recipe with one to three options drawn by tests/helpers/options.py, run in a fork of a process that has
everything imported, with a scene so small that what is accepted ends in seconds. What is still at work after `SECONDS`
of processor time counts as accepted if it has printed or written anything. The same seed draws the same cases. The exit
status is 1 if a case did not end as it should; those are listed.
"""

import os
import random
import resource
import shutil
import tempfile
from contextlib import contextmanager
from pathlib import Path

os.environ |= {"OMP_NUM_THREADS": "1", "HF_HUB_OFFLINE": "1", "WANDB_MODE": "offline"}
os.environ |= {"http_proxy": "http://127.0.0.1:9", "https_proxy": "http://127.0.0.1:9"}  # nothing is looked up outside

import numpy as np
from campaign import conclude, start
from commands import SHORT
from forks import no_pictures, run, warm_up
from options import SCHEMAS, command_line, draw_arguments, is_no_number, program
from PIL import Image
from rooms import grid_scene
from tours import written

from dirl.scenes import write_dump
from dirl.scenes.views import encode

SECONDS, PATIENCE, MEMORY = 6.0, 100, 8 * 2**30

TINY = [*SHORT, "reinforcement.frames_per_scene=60", "imitation.max_steps=2", "evaluation.times=0"]

RECIPES = ("train",) * 9 + ("evaluate",) * 3 + tuple(name for name in SCHEMAS if name != "benchmark")
"""From which a case draws."""

LINE, ACCEPTED, STOPPED = "one line", "accepted, done", "accepted, stopped"
NO_NUMBER, TRACEBACK, LINES, CRASH, HANG = "ACCEPTED NO NUMBER", "TRACEBACK", "NOT ONE LINE", "CRASH", "HANG"
FAILURES = (NO_NUMBER, TRACEBACK, LINES, CRASH, HANG)


@contextmanager
def work():
    """A folder with ``room.h5``, photographs of a walk and their map, a tour and a finished run; removed at the end."""
    folder = Path(tempfile.mkdtemp())  # a TemporaryDirectory would be removed at the end of the first fork
    try:
        rng = np.random.default_rng(0)
        views = [encode(rng.integers(0, 256, (12, 16, 3), np.uint8)) for _ in range(24)]
        write_dump(folder / "room.h5", grid_scene(goals=(0, 13), feature_width=32), views)
        written("pannellum", folder / "tour")
        (folder / "walk").mkdir()
        wall = Image.fromarray(rng.integers(0, 256, (12, 40), np.uint8)).resize((640, 192), Image.Resampling.BICUBIC)
        rows = ["image,location,heading,x,z,ahead"]
        for frame in range(8):  # which passes by, a bit each time
            wall.crop((32 * frame, 0, 32 * frame + 256, 192)).save(folder / "walk" / f"{frame}.png")
            rows.append(f"{frame}.png,{frame // 4},{frame % 4 * 90},{frame // 4},0,{'' if frame else '1'}")
        (folder / "walk" / "states.csv").write_text("\n".join([*rows, ""]))
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


def prepare():
    """In the child: no pictures, and little memory."""
    no_pictures()
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))


def outcome(ended, began, recipe, arguments):
    """What came of a case; ``began``: it wrote a file or printed anything."""
    if ended.status is None:
        return STOPPED if began or recipe == "build" else HANG  # which says nothing before it is done
    if ended.status < 0:
        return CRASH
    if "Traceback" in ended.errors:
        return TRACEBACK
    if ended.status == 0:
        return NO_NUMBER if any(is_no_number(recipe, one) for one in arguments) else ACCEPTED
    # Of a sweep each job that failed has a line, and Hydra writes one of its own.
    told = [line for line in ended.told if not line.startswith(("failed: multirun", "Error executing job"))]
    return LINE if ended.status in (1, 2, 71, 74) and len(told) == 1 else LINES


def try_case(number, seed, files):
    """Draw a case and run it; returns the recipe, the outcome, the drawn arguments and the last lines."""
    rng = random.Random(f"{seed}/{number}")
    recipe = rng.choice(RECIPES)
    arguments = draw_arguments(rng, recipe)
    inside = files / "case" / "inside"  # what is written to .. stays in a folder of ours
    inside.mkdir(parents=True)
    words = command_line(recipe, arguments, files, TINY)
    ended = run(inside, program(recipe), *words, prepare=prepare, timeout=SECONDS, patience=PATIENCE)
    began = bool(ended.printed or ended.errors) or any(inside.iterdir())
    shutil.rmtree(files / "case")
    return recipe, outcome(ended, began, recipe, arguments), arguments, ended.told[-3:]


def main(count=500, seed=0):
    """Try ``count`` cases; how many went wrong."""
    warm_up("train", "evaluate", "report", "scenes", "map", "go")
    with work() as folder:
        return conclude((try_case(number, seed, folder) for number in range(count)), FAILURES)


if __name__ == "__main__":
    start(main)
