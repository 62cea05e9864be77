import errno
import os
import subprocess
import sys

from refusals import refused

from dirl.runs.locks import FolderLock

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
