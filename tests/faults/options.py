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
import sys
import tempfile
from collections import Counter
from contextlib import suppress
from pathlib import Path

os.environ |= {"OMP_NUM_THREADS": "1", "HF_HUB_OFFLINE": "1", "WANDB_MODE": "offline"}
os.environ |= {"http_proxy": "http://127.0.0.1:9", "https_proxy": "http://127.0.0.1:9"}  # nothing is looked up outside
sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))
sys.path.insert(0, str(Path(__file__).parents[2] / "recipes"))

import h5py
import numpy as np
from commands import SHORT, room_file
from counts import table
from forks import no_pictures, run, warm_up
from options import command_line, draw_arguments, is_no_number, program
from PIL import Image

SECONDS, PATIENCE, MEMORY = 6.0, 100, 8 * 2**30

TINY = [*SHORT, "reinforcement.frames_per_scene=60", "imitation.max_steps=2", "evaluation.times=0"]

RECIPES = ("train",) * 10 + ("evaluate",) * 4 + ("report",) * 2
RECIPES += ("thor", "draft", "photos", "recording", "build", "sample", "encode", "export", "import", "inspect")
"""From which a case draws."""

LINE, ACCEPTED, STOPPED = "one line", "accepted, done", "accepted, stopped"
NO_NUMBER, TRACEBACK, LINES, CRASH, HANG = "ACCEPTED NO NUMBER", "TRACEBACK", "NOT ONE LINE", "CRASH", "HANG"
FAILURES = (NO_NUMBER, TRACEBACK, LINES, CRASH, HANG)
OUTCOMES = (LINE, ACCEPTED, STOPPED, *FAILURES)


def make_files(folder):
    """The scene, run and photographs that the cases use."""
    room_file(folder)
    photos = folder / "photos"
    photos.mkdir()
    rng = np.random.default_rng(0)
    rows = ["image,location,heading,x,z,ahead"]
    for state in range(8):
        Image.fromarray(rng.integers(0, 256, (24, 32, 3), np.uint8)).save(photos / f"{state}.png")
        ahead = "" if state % 4 or state > 3 else "4"
        rows.append(f"{state}.png,{state // 4},{state % 4 * 90},{state // 4},0,{ahead}")
    (photos / "states.csv").write_text("\n".join([*rows, ""]))
    with h5py.File(folder / "robot.h5", "w") as file:
        file["images"] = rng.integers(0, 256, (2, 2, 4, 12, 16, 3), np.uint8)
    ended = run(folder, "train", f"scene={folder / 'room.h5'}", *SHORT, "hydra.run.dir=runs/fast/0")
    assert ended.status == 0, ended.errors


def prepare():
    """In the child: no pictures, and little memory."""
    no_pictures()
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))


def outcome(ended, began, recipe, arguments):
    """What came of a case; ``began``: it wrote a file or printed anything."""
    if ended.status is None:
        return STOPPED if began else HANG
    if ended.status < 0:
        return CRASH
    if "Traceback" in ended.errors:
        return TRACEBACK
    if ended.status == 0:
        return NO_NUMBER if any(is_no_number(recipe, one) for one in arguments) else ACCEPTED
    return LINE if ended.status in (1, 2, 71, 74) and len(ended.told) == 1 else LINES


def try_case(number, seed, files):
    """Draw a case and run it; returns the recipe, the drawn arguments, the outcome and the last lines."""
    rng = random.Random(f"{seed}/{number}")
    recipe = rng.choice(RECIPES)
    arguments = draw_arguments(rng, recipe)
    inside = files / "case" / "inside"  # what is written to .. stays in a folder of ours
    inside.mkdir(parents=True)
    words = command_line(recipe, arguments, files, TINY)
    ended = run(inside, program(recipe), *words, prepare=prepare, timeout=SECONDS, patience=PATIENCE)
    began = bool(ended.printed or ended.errors) or any(inside.iterdir())
    shutil.rmtree(files / "case")
    return recipe, arguments, outcome(ended, began, recipe, arguments), ended.told[-3:]


def main(count=500, seed=0):
    """Try ``count`` cases; print the table; 1 if something went wrong."""
    warm_up("train", "evaluate", "report", "scenes")
    folder = Path(tempfile.mkdtemp())  # a TemporaryDirectory would be removed at the end of the first fork
    try:
        make_files(folder)
        done = [try_case(number, seed, folder) for number in range(count)]
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    print(f"{len(done)} cases, seed {seed}\n")
    print(table(Counter((recipe, found) for recipe, _, found, _ in done), "recipe", OUTCOMES))
    failed = [f"{what}: {recipe} {given}: {told}" for recipe, given, what, told in done if what in FAILURES]
    print("\n".join(["", *(failed or ["no failures"])]))
    return bool(failed)


if __name__ == "__main__":
    with suppress(BrokenPipeError):
        sys.exit(main(**{key: int(value) for key, value in (argument.split("=") for argument in sys.argv[1:])}))
