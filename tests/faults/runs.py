"""Break runs, machines and checkpoints: a table of counts.

    python tests/faults/runs.py                                            # a minute
    python tests/faults/runs.py kills=200 faults=200 bytes=10000 folders=1000 signals=50 seed=1

Ends with status 1 if anything was not as docs/reliability.md promises, after a line for each such case.
"""

import random
import shutil
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "helpers"))

from forks import warm_up
from run_faults import CASES, Bench

COUNTS = {
    "kills": 4,
    "signals": 2,
    "faults": 6,
    "bytes": 300,
    "folders": 100,
    "machine": 1,
    "seed": 0,
}
"""How often each thing is tried; ``machine`` is a round of the cases that stand for themselves."""


def main(arguments):
    """Try everything, print the table; whether all was as promised."""
    counts = COUNTS | {name: int(value) for name, value in (text.split("=") for text in arguments)}
    began = time.monotonic()
    warm_up("train")
    folder = Path(tempfile.mkdtemp(prefix="faults-"))
    rows, bad = [], 0
    try:
        bench = Bench(folder)
        for name, case in CASES.items():
            outcomes = Counter()
            for what, problem in case(bench, counts[name], random.Random(f"{name}{counts['seed']}")):
                outcomes[problem.split(":")[0] or "as promised"] += 1
                if problem:
                    print(f"{name}: {what}: {problem}", flush=True)
            bad += sum(outcomes.values()) - outcomes["as promised"]
            rest = ", ".join(f"{number} {problem}" for problem, number in outcomes.items() if problem != "as promised")
            rows.append(f"| {name} | {sum(outcomes.values())} | {outcomes['as promised']} | {rest or 'none'} |")
            print(rows[-1], flush=True)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    print("\n".join(["", "| what | tried | as promised | otherwise |", "|---|--:|--:|---|", *rows]))
    print(f"\nseed {counts['seed']}, {time.monotonic() - began:.0f} s")
    return not bad


if __name__ == "__main__":
    sys.exit(not main(sys.argv[1:]))
