import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
import torch

from dirl.runs.errors import interruptible, one_line_exits


@pytest.fixture(autouse=True)
def interrupts():
    """Ctrl-C as a terminal's programs have it: those that a shell starts in the background ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def ended(problem, capsys):
    """The status and the lines that a program ends with in which something is raised."""
    with pytest.raises(SystemExit) as caught, one_line_exits(lambda: "all is safe"):
        problem()
    return caught.value.code, capsys.readouterr().err.splitlines()


def full():
    raise OSError(28, "No space left on device", "runs/a/config.yaml")


def raising(error):
    def problem():
        raise error

    return problem


def swallowed():
    try:
        os.kill(os.getpid(), signal.SIGINT)
    except KeyboardInterrupt:  # as C code does that cannot convert an argument
        raise ValueError("Invalid bounding box") from None


@pytest.mark.parametrize(
    ("problem", "status", "line"),
    [
        (full, 74, "error: runs/a/config.yaml: No space left on device; make room on the disk"),
        (raising(OSError("cannot write")), 74, "error: cannot write"),
        (lambda: Path("/nowhere/a").read_text(), 74, "error: /nowhere/a: No such file or directory; was it deleted or"),
        (lambda: np.empty(2**55), 71, "error: memory ran out"),
        (lambda: torch.empty(2**60), 71, "error: memory ran out"),
        (raising(RuntimeError("unable to allocate shared memory(shm) for file </a>")), 71, "error: shared memory ran"),
        (raising(KeyboardInterrupt()), 130, "interrupted"),
        (lambda: os.kill(os.getpid(), signal.SIGINT), 130, "interrupted"),
        (lambda: os.kill(os.getpid(), signal.SIGTERM), 143, "terminated"),
        (swallowed, 130, "interrupted"),
    ],
)
def test_an_error_of_the_machine_gets_one_line_and_its_status(capsys, problem, status, line):
    code, (told,) = ended(problem, capsys)
    assert code == status
    assert told.startswith(line)
    assert told.endswith("; all is safe")


def test_what_is_a_fault_of_the_program_keeps_its_traceback():
    with pytest.raises(RuntimeError, match="a bug"), one_line_exits():
        raise RuntimeError("a bug")


def test_a_closed_pipe_ends_the_program_quietly():
    code = "from dirl.runs.errors import one_line_exits\nwith one_line_exits():\n while True: print('x' * 1000)"
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.readline()
        process.stdout.close()
        errors = process.stderr.read().decode()
    assert process.returncode == 141
    assert errors == "nobody reads any more what this program prints\n"


@pytest.mark.parametrize(("number", "raised"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_the_first_signal_is_noted_and_the_second_acts(number, raised):
    noted = []

    def work():
        with interruptible() as asked:
            os.kill(os.getpid(), number)
            noted.extend(asked)
            os.kill(os.getpid(), number)

    with pytest.raises(SystemExit) as caught, one_line_exits():
        work()
    assert (noted, caught.value.code) == ([number], raised)


def test_handlers_are_as_before_afterwards_and_other_threads_have_none():
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    with one_line_exits(), interruptible():
        pass
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before
    noted = []

    def work():
        with one_line_exits(), interruptible() as asked:
            noted.append(asked)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert noted == [[]]


def test_it_is_there_before_anything_that_takes_time():
    code = "import sys, dirl.runs.errors; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
