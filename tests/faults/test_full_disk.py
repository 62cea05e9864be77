import shutil
import subprocess

import pytest
from commands import SHORT, done, have_the_same_weights, room_file, run_recipe

from dirl.runs.checkpoints import training_checkpoints


@pytest.fixture
def mount(tmp_path):
    """A function that mounts a file system of a size, or changes its size; skips where that is not permitted."""
    disk = tmp_path / "disk"
    disk.mkdir()
    if shutil.which("mount") is None:
        pytest.skip("there is no mount")

    def resize(size, option="size"):
        command = ["mount", "-t", "tmpfs", "-o", f"{option}={size}", "tmpfs", str(disk)]
        return subprocess.run(command, capture_output=True, check=False).returncode == 0

    if not resize("120k"):
        pytest.skip("mounting is not permitted")
    yield disk, lambda size: resize(size, "remount,size")
    subprocess.run(["umount", "-l", str(disk)], check=True)


def test_a_full_disk_is_one_line_and_the_run_resumes_when_there_is_room(tmp_path, mount):
    disk, resize = mount
    options = [f"scene={room_file(tmp_path)}", *SHORT]
    status, _, errors = run_recipe(tmp_path, "train", *options, f"hydra.run.dir={disk / 'run'}")
    (told,) = (line for line in errors.replace("\r", "\n").splitlines() if line and "frames/s" not in line)
    assert status == 74, errors
    assert "No space left on device; make room on the disk; its last checkpoint is safe; resume with:" in told
    assert training_checkpoints(disk / "run")

    assert resize("20m")
    done(tmp_path, "train", f"resume={disk / 'run'}")
    assert run_recipe(tmp_path, "train", *options, "hydra.run.dir=whole")[0] == 0
    assert have_the_same_weights(disk / "run", tmp_path / "whole")
