"""Small samples of the campaigns, of other seeds than full runs have."""

import os
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists() or not hasattr(os, "fork"), reason="of Linux")
@pytest.mark.parametrize(
    "words",
    ["declared quick", "dumps count=100 seed=1", "runs kills=1 signals=1 faults=2 machine=0"],
)
def test_what_is_promised_holds_in_a_small_sample(words):
    name, *arguments = words.split()
    command = [sys.executable, str(Path(__file__).with_name(f"{name}.py")), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=3600, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.endswith(" 0 failed\n") or done.stdout.endswith("\n0 failed\n")
