"""Break runs and machines: how often each thing was as promised.

    python tests/faults/runs.py                                            # a minute
    python tests/faults/runs.py kills=200 faults=200 signals=50 early=20 seed=1

Ends with status 1 if anything was not as docs/reliability.md promises, after a line for each such case. ``early`` is
blamed for what other programs put into /dev/shm meanwhile; docs/reliability.md says how it gets one of its own.
"""

import json
import os
import random
import resource
import secrets
import shutil
import signal
import tempfile
import time
from contextlib import suppress
from functools import partial
from itertools import count
from pathlib import Path

from campaign import conclude, start
from commands import SHORT, have_the_same_weights, room_file, rows_of, summary_of
from forks import Child, no_pictures, processor_seconds, run, warm_up
from injection import KINDS, Faults

from dirl.runs.checkpoints import is_finished, training_checkpoints

COUNTS = {"kills": 4, "signals": 2, "faults": 6, "machine": 1, "early": 1, "seed": 0}
"""How often each thing is tried; ``machine`` is a round of the cases that stand for themselves."""

ROOMS = "sample kind=bathroom out=rooms height=16 width=16 encoder=null fine=false workers=2 count=2"
SHARED = Path("/dev/shm")
PATIENCE = 600.0
"""Seconds in which what a killed program has started must end; on a busy machine what still imports sees it late."""

TIMES = ("seconds", "frames_per_second", "peak_memory_mb")
"""What differs from run to run."""


class Bench:
    """A scene, a run that nothing happened to, and folders for those that something happens to.

    Args:
        folder: for all of them.
    """

    def __init__(self, folder):
        self.folder = folder
        self.scene = room_file(folder)
        self._numbers = count()
        began = time.monotonic()
        self.whole = self.new_folder()
        counts = folder / "counts.json"
        ended = self.train(self.whole, prepare=lambda: Faults(self.whole).install(counts))
        assert ended.status == 0, ended.errors
        self.seconds = time.monotonic() - began
        self.calls = json.loads(counts.read_text())

    def new_folder(self):
        """A folder that is not there yet."""
        return self.folder / f"run{next(self._numbers)}"

    def options(self, folder):
        """Of a run in a folder: begun, or gone on with if there is one."""
        begun = (folder / "config.yaml").exists() or training_checkpoints(folder)
        return [f"resume={folder}"] if begun else [f"scene={self.scene}", *SHORT, f"hydra.run.dir={folder}"]

    def train(self, folder, prepare=lambda: None):
        """Run to the end."""
        return run(self.folder, "train", *self.options(folder), prepare=prepare)

    def start(self, folder, prepare=lambda: None):
        """Begin, without waiting."""
        return Child(self.folder, "train", *self.options(folder), prepare=prepare)

    def finish(self, folder):
        """Go on with a run until it is finished; what is not as in the run that nothing happened to."""
        if not is_finished(folder):
            ended = self.train(folder, prepare=no_pictures)
            if ended.status != 0:
                return ended.problem or f"does not go on: {ended.told}"
        difference = self.difference(folder)
        shutil.rmtree(folder)
        return difference

    def difference(self, folder):
        """What a finished run has otherwise than the one that nothing happened to; nothing is an empty text."""
        # Where removing fails, the lock or an empty folder stays; neither is an obstacle.
        names, expected = (
            {file.name for file in one.iterdir() if file.is_file() and file.name != ".lock"}
            for one in (folder, self.whole)
        )
        if names != expected:
            return f"other files: {sorted(names)}"
        for file in sorted(self.whole.glob("*.csv")):
            first, second = ([without_times(row) for row in rows_of(one)] for one in (file, folder / file.name))
            if first != second:
                return f"other rows: {file.name}"
        first, second = (without_times(summary_of(one)) for one in (self.whole, folder))
        if first != second:
            return "another summary"
        return "" if have_the_same_weights(self.whole, folder) else "other weights"


def without_times(row):
    """A row or summary without what differs from run to run."""
    return {key: value for key, value in row.items() if key not in TIMES}


def refused(ended, *statuses):
    """What is wrong with the end of a recipe that should have refused; nothing is an empty text."""
    if ended.problem:
        return f"{ended.problem}: {ended.errors[-300:]}"
    if ended.status == 0:
        return "accepted"
    if ended.status not in statuses:
        return f"another status: {ended.status}, {ended.told}"
    return "" if len(ended.told) == 1 else f"not one line: {ended.told}"


def kills(bench, times, rng):
    """SIGKILL at random moments, up to six in a run, that then goes on to its end."""
    done = 0
    while done < times:
        folder, problem, killed = bench.new_folder(), "", 0
        for _ in range(min(rng.randint(1, 6), times - done)):
            child = bench.start(folder, no_pictures)
            time.sleep(rng.uniform(0, bench.seconds))
            child.send_signal()
            ended = child.wait()
            if ended.status == -signal.SIGKILL:
                killed += 1
                continue
            problem = ended.problem if ended.status else ""
            break
        done += killed
        problem = problem or bench.finish(folder)
        yield from ((f"kill of {folder.name}", problem) for _ in range(killed))


def signals(bench, times, rng):
    """SIGINT and SIGTERM at random moments: one line, the status of the signal, and the run goes on."""
    for number in range(times):
        folder, sent = bench.new_folder(), (signal.SIGINT, signal.SIGTERM)[number % 2]
        child = bench.start(folder)
        time.sleep(rng.uniform(0.2, 1) * bench.seconds)
        child.send_signal(sent)
        ended = child.wait()
        problem = "" if ended.status == 0 else refused(ended, 128 + sent)
        yield f"{sent.name}, {ended.told}", problem or bench.finish(folder)


def faults(bench, times, rng):
    """The n-th call of a kind fails, once or from then on: one line, and the run goes on."""
    calls = [(kind, number) for kind in KINDS for number in range(1, bench.calls[kind] + 1)]
    for kind, number in rng.sample(calls, min(times, len(calls))):
        folder, lasting = bench.new_folder(), rng.random() < 0.5
        fault = Faults(folder, kind, number, lasting)
        ended = bench.train(folder, prepare=fault.install)
        problem = "" if ended.status == 0 else refused(ended, 74)
        if not problem and [file for file in folder.rglob(".unfinished-*") if not (kind == "remove" and lasting)]:
            problem = "left a temporary file"
        yield f"{kind} {number} of {bench.calls[kind]}{' and all after' * lasting}", problem or bench.finish(folder)


def machine(bench, times, rng):
    """Cases that stand for themselves, so many rounds of them; others are in tests/runs."""
    for _ in range(times):
        for case in (file_limit, deleted_folder):
            yield case.__doc__.rstrip("."), case(bench)


def file_limit(bench):
    """A limit of 25 kB a file, which a checkpoint does not keep."""
    folder = bench.new_folder()
    ended = bench.train(folder, lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (25_000, 25_000)))
    return refused(ended, 74) or bench.finish(folder)


def deleted_folder(bench):
    """The folder of a running run is deleted."""
    folder = bench.new_folder()
    child = bench.start(folder)
    while not training_checkpoints(folder) and os.path.exists(f"/proc/{child.pid}/fd"):
        time.sleep(0.01)
    shutil.rmtree(folder, ignore_errors=True)
    return refused(child.wait(), 74)


def early(bench, times, rng):
    """SIGKILL within a second of a program with processes of its own: nothing of it stays, and the same works then."""
    programs = {"train": [f"scene={bench.scene}", *SHORT, "system=a3c"], "scenes": ROOMS.split()} if times else {}
    for name, words in programs.items():
        folder = bench.new_folder()
        folder.mkdir()
        for _ in range(times):
            word, before = secrets.token_hex(8), set(SHARED.iterdir())
            delay, began = rng.uniform(0, 1), time.monotonic()
            child = Child(folder, name, *words, prepare=partial(os.environ.update, DIRL_EARLY=word))
            while time.monotonic() < began + 3 * delay and processor_seconds(child.pid) < delay:
                time.sleep(0.005)
            child.send_signal()
            child.wait()
            left = left_behind(word, before)
            yield f"{name}, killed after {delay:.2f} s", f"left {left}" if left else ""
        ended = run(folder, name, *words)
        yield f"{name}, after its kills", f"status {ended.status}, {ended.told}" if ended.status else ""


def left_behind(word, before):
    """The processes with a word in their environment, and what is new in shared memory, after some time; all end."""
    ends = time.monotonic() + PATIENCE
    while (left := [*of_word(word), *(set(SHARED.iterdir()) - before)]) and time.monotonic() < ends:
        time.sleep(0.2)
    for one in left:
        with suppress(OSError, TypeError):
            os.kill(one, signal.SIGKILL)
    return left


def of_word(word):
    """The processes that have a word in their environment."""
    for file in Path("/proc").glob("[0-9]*/environ"):
        with suppress(OSError):
            if word.encode() in file.read_bytes():
                yield int(file.parent.name)


CASES = {"kills": kills, "signals": signals, "faults": faults, "machine": machine, "early": early}
"""Each takes a `Bench`, how often, and a random number generator; yields what was done, and what was wrong with it."""


def main(**given):
    """Try everything so often; how much was not as promised."""
    counts = COUNTS | given
    warm_up("train", "scenes")
    folder = Path(tempfile.mkdtemp(prefix="faults-"))
    try:
        bench = Bench(folder)
        cases = (
            (name, "otherwise" if problem else "as promised", what, problem)
            for name, case in CASES.items()
            for what, problem in case(bench, counts[name], random.Random(f"{name}{counts['seed']}"))
        )
        return conclude(cases, ["otherwise"])
    finally:
        shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    start(main)
