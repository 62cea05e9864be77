"""The quick part of declared.py: small files that declare much."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = Path(__file__).with_name("declared.py")


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists() or not hasattr(os, "fork"), reason="of Linux")
def test_small_files_that_declare_much_are_refused_at_once():
    done = subprocess.run(
        [sys.executable, str(PROGRAM), "quick"], capture_output=True, text=True, timeout=3600, check=False
    )
    assert (done.returncode, done.stderr) == (0, ""), done.stdout + done.stderr
    assert done.stdout.endswith(" cases, 0 failed\n")
