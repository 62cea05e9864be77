"""Tasks in several processes."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from commands import wait_until
from refusals import refused
from tasks import die, fail

from dirl.scenes.io.processes import in_processes


def test_a_failed_simulator_in_a_process_and_a_killed_process_are_one_line():
    told = r"^VizDoom failed \(RuntimeError: its window is gone\); run the command again$"
    refused(told, list, in_processes([fail], 1, "a test"))
    told = "^rooms: a process was killed, .*; if it happens again, give workers=1$"
    refused(told, list, in_processes([die], 1, "rooms: a process"))


@pytest.mark.skipif(os.name != "posix", reason="elsewhere 0 is a signal that ends a process")
def test_the_processes_of_a_program_that_is_killed_end(tmp_path):
    program, told = tmp_path / "program.py", tmp_path / "told"
    program.write_text(
        "from functools import partial\nfrom tasks import idle\nfrom dirl.scenes.io.processes import in_processes\n"
        f"if __name__ == '__main__':\n    list(in_processes([partial(idle, {str(told)!r})], 1, 'a test'))\n"
    )
    path = os.pathsep.join([str(Path(__file__).parents[2] / "helpers"), *filter(None, sys.path)])
    owner = subprocess.Popen([sys.executable, str(program)], env={**os.environ, "PYTHONPATH": path})
    wait_until(told.exists)
    owner.kill()
    owner.wait()
    with pytest.raises(ProcessLookupError):
        wait_until(lambda: os.kill(int(told.read_text()), 0), patience=60)
