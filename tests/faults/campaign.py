"""What the campaigns share: their command lines, forks with limits, and counts of outcomes."""

import os
import resource
import sys
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))
sys.path.insert(0, str(Path(__file__).parents[2] / "recipes"))


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
