"""What other systems lack: without it everything is imported, and a run is trained, resumed and evaluated."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from commands import TINY, room_file

LACKING = """
import pathlib, signal, sys
for name in ("resource", "fcntl", "pwd", "grp", "termios"):
    sys.modules[name] = None
for name in ("SIGHUP", "SIGXCPU", "SIGALRM", "SIGUSR1"):
    delattr(signal, name)
exists = pathlib.Path.exists
pathlib.Path.exists = lambda path, **options: not str(path).startswith("/proc") and exists(path, **options)
"""
"""Run by Python before anything else: what Windows does not have."""

IMPORTS = """
import importlib, pkgutil, dirl
for module in pkgutil.walk_packages(dirl.__path__, "dirl."):
    if module.name != "dirl.__main__":
        importlib.import_module(module.name)
"""

ROOT = Path(__file__).parents[1]


@pytest.fixture
def python(tmp_path):
    (tmp_path / "sitecustomize.py").write_text(LACKING)
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}

    def run(*arguments):
        command = [sys.executable, *map(str, arguments)]
        return subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=environment, check=False)

    assert run("-c", "import fcntl").returncode != 0
    return run


def test_every_module_can_be_imported_without_what_windows_lacks(python):
    done = python("-c", IMPORTS)
    assert done.returncode == 0, done.stderr


def test_a_run_is_trained_and_evaluated_without_what_windows_lacks(python, tmp_path):
    done = python(ROOT / "recipes/train.py", f"scene={room_file(tmp_path)}", *TINY, "hydra.run.dir=run")
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["peak_memory_mb"] is None
    assert "nan" not in done.stdout
    done = python(ROOT / "recipes/evaluate.py", "checkpoint=run", "out=result.json")
    assert done.returncode == 0, done.stderr
    assert "greedy" in json.loads((tmp_path / "result.json").read_text())
