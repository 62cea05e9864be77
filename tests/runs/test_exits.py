"""How a program ends when the machine or the user stops it; locks of a run's folder."""

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from refusals import refused

from dirl.runs.exits import interruptible, one_line_exits
from dirl.runs.locks import FolderLock


@pytest.fixture(autouse=True)
def interrupts():
    """Ctrl-C as a terminal's programs have it: those that a shell starts in the background ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def raising(error):
    def problem():
        raise error

    return problem


def swallowed():
    try:
        os.kill(os.getpid(), signal.SIGINT)
    except KeyboardInterrupt:  # as C code does that cannot convert an argument
        raise ValueError("Invalid bounding box") from None


FULL = OSError(28, "No space left on device", "runs/a/config.yaml")
SHARED = RuntimeError("unable to allocate shared memory(shm) for file </a>")


@pytest.mark.parametrize(
    ("problem", "status", "line"),
    [
        (raising(FULL), 74, "error: runs/a/config.yaml: No space left on device; make room on the disk"),
        (raising(OSError("cannot write")), 74, "error: cannot write"),
        (lambda: Path("/nowhere/a").read_text(), 74, "error: /nowhere/a: No such file or directory; was it deleted or"),
        (lambda: np.empty(2**55), 71, "error: memory ran out"),
        (lambda: torch.empty(2**60), 71, "error: memory ran out"),
        (raising(SHARED), 71, "error: shared memory ran"),
        (lambda: os.kill(os.getpid(), signal.SIGINT), 130, "interrupted"),
        (lambda: os.kill(os.getpid(), signal.SIGTERM), 143, "terminated"),
        (swallowed, 130, "interrupted"),
    ],
)
def test_an_error_of_the_machine_gets_one_line_and_its_status(capsys, problem, status, line):
    with pytest.raises(SystemExit) as caught, one_line_exits(lambda: "all is safe"):
        problem()
    assert caught.value.code == status
    (told,) = capsys.readouterr().err.splitlines()
    assert told.startswith(line)
    assert told.endswith("; all is safe")


def test_a_closed_pipe_ends_the_program_quietly_and_nothing_slow_is_imported():
    code = "import sys\nfrom dirl.runs.exits import one_line_exits\nassert 'torch' not in sys.modules\n"
    code += "with one_line_exits():\n while True: print('x' * 1000)"
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.readline()
        process.stdout.close()
        errors = process.stderr.read().decode()
    assert (process.returncode, errors) == (141, "nobody reads any more what this program prints\n")


@pytest.mark.parametrize(("number", "raised"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_the_first_signal_is_noted_and_the_second_acts(number, raised):
    with pytest.raises(SystemExit) as caught, one_line_exits(), interruptible() as asked:  # noqa: PT012
        os.kill(os.getpid(), number)
        assert asked == [number]
        os.kill(os.getpid(), number)
    assert caught.value.code == raised
    with pytest.raises(RuntimeError, match="a bug"), one_line_exits():  # which keeps its traceback
        raise RuntimeError("a bug")


HOLD = "import sys, time; from pathlib import Path; from dirl.runs.locks import FolderLock; "
HOLD += "lock = FolderLock(Path(sys.argv[1])); print('held', flush=True); time.sleep(600)"


def test_another_process_is_named_and_its_death_frees_the_folder(tmp_path):
    with subprocess.Popen([sys.executable, "-c", HOLD, tmp_path], stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout.readline() == b"held\n"
            refused(f"{tmp_path}: process {process.pid} on .* is writing to it", FolderLock, tmp_path)
        finally:
            process.kill()
    assert (tmp_path / ".lock").exists()
    FolderLock(tmp_path).release()
    assert not (tmp_path / ".lock").exists()


def test_without_locks_the_run_goes_on_and_says_so(tmp_path, monkeypatch, capsys):
    def no_locks(*_):
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr("fcntl.flock", no_locks)
    FolderLock(tmp_path).release()
    (told,) = capsys.readouterr().err.splitlines()
    assert told == f"{tmp_path}: cannot be locked (No locks available); do not resume this run while it runs"
