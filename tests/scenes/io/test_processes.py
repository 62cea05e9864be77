"""Tasks in several processes."""

import pytest
from tasks import die, fail

from dirl.scenes import SceneError
from dirl.scenes.io.processes import in_processes
from dirl.scenes.live import SimulatorError


def test_a_failed_simulator_in_a_process_is_its_one_line():
    with pytest.raises(
        SimulatorError, match=r"^VizDoom failed \(RuntimeError: its window is gone\); run the command again$"
    ):
        list(in_processes([fail], 1, "a test"))


def test_a_killed_process_is_one_line():
    with pytest.raises(SceneError, match=r"^rooms: a process was killed, .*; if it happens again, give workers=1$"):
        list(in_processes([die], 1, "rooms: a process"))
