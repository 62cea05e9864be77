"""What other systems lack: without it everything is imported, and a run is trained, resumed and evaluated."""

import json
import os
import subprocess
import sys

from commands import ROOT, TINY, room_file
from PIL import Image

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

PROGRAM = """
import importlib, multiprocessing, pkgutil, runpy, sys
import dirl.envs
assert "torchrl" in sys.modules  # which by itself would choose the start method of all later processes
assert multiprocessing.get_start_method(allow_none=True) is None
for module in pkgutil.walk_packages(dirl.__path__, "dirl."):
    if module.name != "dirl.__main__":
        importlib.import_module(module.name)
recipes, *options = sys.argv[1:]
for recipe, given in (("train", options), ("evaluate", ["checkpoint=run", "out=result.json"])):
    sys.argv = [recipe, *given]
    runpy.run_path(f"{recipes}/{recipe}.py", run_name="__main__")
"""


def test_every_module_is_imported_and_a_run_trained_and_evaluated_without_what_windows_lacks(tmp_path):
    (tmp_path / "sitecustomize.py").write_text(LACKING)
    path = os.pathsep.join(filter(None, [str(tmp_path), os.environ.get("PYTHONPATH")]))
    environment = {**os.environ, "PYTHONPATH": path}

    def python(*arguments):
        command = [sys.executable, "-c", *map(str, arguments)]
        return subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=environment, check=False)

    assert python("import fcntl").returncode != 0
    done = python(PROGRAM, ROOT / "recipes", f"scene={room_file(tmp_path)}", *TINY, "hydra.run.dir=run")
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["peak_memory_mb"] is None
    assert "nan" not in done.stdout
    pictures = sorted((tmp_path / "run").glob("*.png"))
    assert [file.name for file in pictures] == ["learning_curve.png", "maps_grid.png", "trajectories_grid.png"]
    for file in pictures:
        with Image.open(file) as image:
            assert min(image.size) > 200
    assert "greedy" in json.loads((tmp_path / "result.json").read_text())
