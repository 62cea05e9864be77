"""Tasks in several processes."""

import os
from functools import partial

import pytest
from tasks import die, fail, square

from dirl.scenes import SceneError
from dirl.scenes.io.processes import in_processes
from dirl.scenes.live import SimulatorError


def test_results_come_from_other_processes_with_one_thread():
    results = list(in_processes([partial(square, number) for number in range(4)], 2, "a test"))
    assert sorted(result[0] for result in results) == [0, 1, 4, 9]
    assert os.getpid() not in {result[1] for result in results}
    assert {result[2] for result in results} == {1}


def test_a_failed_simulator_in_a_process_is_its_one_line():
    with pytest.raises(
        SimulatorError, match=r"^VizDoom failed \(RuntimeError: its window is gone\); run the command again$"
    ):
        list(in_processes([fail], 1, "a test"))


def test_a_killed_process_is_one_line():
    with pytest.raises(SceneError, match=r"^rooms: a process was killed, .*; if it happens again, give workers=1$"):
        list(in_processes([die], 1, "rooms: a process"))
