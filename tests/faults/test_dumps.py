"""The quick part of dumps.py: some damaged files, of another seed than a full run's."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = Path(__file__).with_name("dumps.py")


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the program forks")
def test_damaged_dumps_are_refused_or_read_as_they_were():
    done = subprocess.run(
        [sys.executable, str(PROGRAM), "count=100", "seed=1"], capture_output=True, text=True, timeout=3600, check=False
    )
    assert (done.returncode, done.stderr) == (0, ""), done.stdout + done.stderr
    assert done.stdout.startswith("100 files, seed 1\n")
    assert done.stdout.endswith("\nno failures\n")
