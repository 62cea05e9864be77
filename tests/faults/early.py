"""Kill every tool within its first second of work: nothing may stay behind, and the same command works afterwards.

    nice python tests/faults/early.py kills=8 seed=1

Each tool is started as a user does and gets SIGKILL up to a second after it has said ``loading ...``. Then no process
of it may be left, and no file in /dev/shm; after its kills it is run once to its end in the same folder. It prints a
line for each tool; the exit status is 1 if one left anything.
"""

import os
import random
import secrets
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

ROOT = Path(__file__).parents[2]
SHARED = Path("/dev/shm")
PATIENCE = 60.0
"""Seconds in which what a tool has started must end; on a busy machine what still imports sees it late."""

SHORT = ["imitation.max_steps=2", "reinforcement.frames_per_scene=200", "evaluation.times=0", "encoder.width=8"]
TOOLS = {
    "train": ["train.py", "scene=bathroom_02", *SHORT, "hydra.run.dir=run{n}"],
    "a3c": ["train.py", "scene=bathroom_02", "system=a3c", *SHORT, "hydra.run.dir=a3c{n}"],
    "evaluate": ["evaluate.py", "checkpoint=general", "scene=bathroom_02", "goals=[26]"],
    "inspect": ["scenes.py", "inspect", "scene=bathroom_02"],
    "build": [
        "scenes.py",
        "build",
        "description=bathroom_02",
        "out=room.h5",
        "encoder=null",
        "fine=false",
        "workers=2",
    ],
    "sample": ["scenes.py", "sample", "kind=bathroom", "out=rooms", "workers=2"],
    "import": ["scenes.py", "import", "scene=bathroom_02", "out=imported.h5"],
    "encode": ["scenes.py", "encode", "scene=bathroom_02", "encoder=resnet50_small", "out=encoded.h5"],
    "vizdoom": ["scenes.py", "vizdoom", "map=map01", "places=4", "out=doom.h5", "encoder=null"],
    "miniworld": ["scenes.py", "miniworld", "env=FourRooms", "places=4", "out=mini.h5", "encoder=null"],
}
"""The command line of each; {n} is another number for each run."""


def of_word(word):
    """The processes that have a word in their environment."""
    found = []
    for file in Path("/proc").glob("[0-9]*/environ"):
        with suppress(OSError):
            if word.encode() in file.read_bytes():
                found.append(int(file.parent.name))
    return found


def started(words, number, word, folder):
    """A tool that has just begun its work."""
    recipe, *options = (part.format(n=number) for part in words)
    process = subprocess.Popen(
        [sys.executable, str(ROOT / "recipes" / recipe), *options],
        cwd=folder,
        env={**os.environ, "DIRL_EARLY": word},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    process.stderr.readline()  # of its imports
    return process


def left_behind(word, before):
    """What there still is of a tool some seconds after it was killed."""
    ends = time.monotonic() + PATIENCE
    while (left := [*of_word(word), *(set(SHARED.iterdir()) - before)]) and time.monotonic() < ends:
        time.sleep(0.2)
    for one in left:
        with suppress(OSError):
            os.kill(one, signal.SIGKILL) if isinstance(one, int) else one.unlink()
    return left


def try_tool(name, kills, seed, folder):
    """How many kills left something behind, and the status of the run to the end."""
    rng, bad = random.Random(f"{seed}/{name}"), 0
    for number in range(kills):
        word, before = secrets.token_hex(8), set(SHARED.iterdir())
        process = started(TOOLS[name], number, word, folder)
        time.sleep(rng.uniform(0, 1))
        process.kill()
        process.wait()
        process.stderr.close()
        bad += bool(left_behind(word, before))
    process = started(TOOLS[name], kills, "end", folder)
    told = process.communicate()[1].decode()
    return bad, process.returncode, told.splitlines()[-1:]


def main(kills=8, seed=0):
    """Try all tools; 1 if one left anything, or does not work afterwards."""
    failed = 0
    for name in TOOLS:
        with tempfile.TemporaryDirectory() as folder:
            bad, status, told = try_tool(name, kills, seed, folder)
        failed += bool(bad or status)
        print(
            f"{name}: {kills} kills, {bad} left something; afterwards status {status} {told if status else ''}",
            flush=True,
        )
    print(f"\n{len(TOOLS)} tools, {failed} failed")
    return bool(failed)


if __name__ == "__main__":
    sys.exit(main(**{key: int(value) for key, value in (argument.split("=") for argument in sys.argv[1:])}))
