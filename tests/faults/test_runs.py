import subprocess
import sys
from pathlib import Path


def test_what_is_promised_of_runs_holds_in_a_small_sample():
    counts = ["kills=1", "signals=1", "faults=2", "bytes=50", "machine=0"]
    command = [sys.executable, Path(__file__).with_name("runs.py"), *counts]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "| faults | 2 | 2 | none |" in done.stdout
