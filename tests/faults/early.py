"""Kill every tool within its first second of work: nothing may stay behind, and the same command works afterwards.

    nice python tests/faults/early.py kills=8 seed=1

Each tool is run in a fork of a process that has everything imported, so that its second is one of work. It gets SIGKILL
after up to a second of the processor or three of the clock. Then no process of it may be left, and no file in /dev/shm;
after its kills it is run to its end in the folder of one. It prints a line for each tool. Other programs that use
/dev/shm meanwhile would be blamed on it: ``unshare -m sh -c 'mount -t tmpfs tmpfs /dev/shm; exec python ...'``.
"""

import os
import random
import secrets
import signal
import time
from contextlib import suppress
from functools import partial
from pathlib import Path

from campaign import start, work
from forks import Child, processor_seconds, warm_up
from options import SCHEMAS, command_line, program

SHARED = Path("/dev/shm")
PATIENCE = 60.0
"""Seconds in which what a tool has started must end; on a busy machine what still imports sees it late."""

SHORT = ["imitation.max_steps=2", "reinforcement.frames_per_scene=200", "evaluation.times=0", "encoder.width=8"]
LEFT_OUT = ("thor", "simulator", "draft", "benchmark")
"""AI2-THOR is not installed, a simulator of one's own is what MiniWorld is; the others start and write nothing."""


def tools(files):
    """The program and the command line of each tool, by its name."""
    found = {name: (program(name), command_line(name, [], files, SHORT)) for name in SCHEMAS if name not in LEFT_OUT}
    training = [word for word in found["train"][1] if not word.startswith("hydra.run.dir")]  # by the time, as of users
    return found | {
        "train": ("train", training),
        "a3c": ("train", [*training, "system=a3c"]),
        "stacked": ("train", ["-m", *training, "hydra/launcher=stacked", "seed=0,1"]),
        "sample, two processes": ("scenes", [*found["sample"][1][:-1], "workers=2", "count=2"]),
        "go": ("go", [*found["go"][1], "mcap=way.mcap"]),
        "report": ("report", ["experiment=fig8", *found["report"][1][1:]]),
    }


def of_word(word):
    """The processes that have a word in their environment."""
    found = []
    for file in Path("/proc").glob("[0-9]*/environ"):
        with suppress(OSError):
            if word.encode() in file.read_bytes():
                found.append(int(file.parent.name))
    return found


def left_behind(word, before):
    """What there still is of a tool some seconds after it was killed; its processes are ended."""
    ends = time.monotonic() + PATIENCE
    while (left := [*of_word(word), *(set(SHARED.iterdir()) - before)]) and time.monotonic() < ends:
        time.sleep(0.2)
    for one in left:
        with suppress(OSError, TypeError):
            os.kill(one, signal.SIGKILL)
    return left


def kill(tool, words, delay, folder):
    """Kill a tool after so many seconds: what it left behind, and whether it had ended before."""
    word, before, began = secrets.token_hex(8), set(SHARED.iterdir()), time.monotonic()
    child = Child(folder, tool, *words, prepare=partial(os.environ.update, DIRL_EARLY=word))
    while time.monotonic() < began + 3 * delay and processor_seconds(child.pid) < delay:
        time.sleep(0.005)
    child.send_signal()
    ended = child.wait().status != -signal.SIGKILL
    return left_behind(word, before), ended


def try_tool(name, tool, words, kills, seed, folder):
    """Print a line for a tool; whether it left anything, or does not work afterwards."""
    rng, bad, unfinished = random.Random(f"{seed}/{name}"), 0, []
    folders = [folder / f"{name}{number}" for number in range(kills + 1)]
    for one in folders[:-1]:
        one.mkdir()
        left, ended = kill(tool, words, rng.uniform(0, 1), one)
        bad += bool(left)
        written = any(file.is_file() and file.name[0] != "." for file in one.iterdir())  # and is not overwritten
        unfinished += [one] * (not ended and not written)
    folders[-1].mkdir()
    after = Child([folders[-1], *unfinished][-1], tool, *words).wait()
    told = f"then status {after.status} {after.told[-1:] if after.status else ''}"
    print(f"{name}: {kills} kills, {kills - len(unfinished)} after its end, {bad} left something; {told}", flush=True)
    return bool(bad or after.status)


def main(kills=8, seed=0):
    """Try all tools; how many failed."""
    warm_up("train", "evaluate", "report", "scenes", "map", "go")
    with work() as folder:
        return sum(try_tool(name, *tool, kills, seed, folder) for name, tool in tools(folder).items())


if __name__ == "__main__":
    start(main)
