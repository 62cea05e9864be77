"""Recipes run again and again without the seconds that their imports take: each in a fork of one process.

A child is what ``python recipes/<name>.py <arguments>`` would be, after its imports. Campaigns fork themselves. pytest
cannot: what a test did to its process, and the threads that torch started there, would be in the child. It forks a
server that does nothing but import, see `commands.start_recipe`.
"""

import atexit
import importlib
import multiprocessing
import os
import runpy
import signal
import sys
import tempfile
import threading
import time
import traceback
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

ROOT = Path(__file__).parents[2]


@dataclass
class Ended:
    """How a recipe ended: its exit status (negative for a signal, None if it had to be stopped) and what it printed."""

    status: int | None
    printed: str
    errors: str

    @property
    def problem(self):
        """What must never be: a hang, a crash, a traceback; nothing else, and no problem is an empty text."""
        if self.status is None:
            return "hang"
        if self.status < 0:
            return f"crash by signal {-self.status}"
        return "traceback" if "Traceback" in self.errors else ""

    @property
    def told(self):
        """The lines on the standard error, without the progress bar's."""
        lines = [line.rpartition("\r")[2].strip() for line in self.errors.splitlines()]
        return [line for line in lines if line and "%|" not in line and "frames/s" not in line]


class Child:
    """A recipe that is running.

    Args:
        folder: where it runs.
        name: of the recipe.
        arguments: of its command line.
        prepare: called in the child before the recipe.
        method: "forkserver" forks the server of `multiprocessing`, "fork" this process.
    """

    def __init__(self, folder, name, *arguments, prepare=lambda: None, method="fork"):
        self.files = [tempfile.NamedTemporaryFile() for _ in ("printed", "errors")]  # noqa: SIM115
        words = [str(ROOT / "recipes" / f"{name}.py"), *map(str, arguments)]
        given = (folder, words, [file.name for file in self.files], prepare)
        self.process = multiprocessing.get_context(method).Process(target=_become, args=given)
        sys.stdout.flush()
        sys.stderr.flush()
        self.process.start()
        self.pid = self.process.pid

    def send_signal(self, number=signal.SIGKILL):
        """Send it a signal."""
        os.kill(self.pid, number)

    def wait(self, timeout=120.0, patience=5):
        """Wait for its end; stop it after so many processor seconds, or ``patience`` times as many of the clock."""
        began, stopped = time.monotonic(), False
        while self.process.exitcode is None:
            if processor_seconds(self.pid) > timeout or time.monotonic() - began > patience * timeout:
                stopped = True
                self.process.kill()
            time.sleep(0.01)
        texts = [file.read().decode(errors="replace").removeprefix("loading ...\n") for file in self.files]
        return Ended(None if stopped else self.process.exitcode, *texts)


def run(folder, name, *arguments, prepare=lambda: None, timeout=120.0, patience=5):
    """Run a recipe to its end, see `Child`."""
    return Child(folder, name, *arguments, prepare=prepare).wait(timeout, patience)


def warm_up(*names):
    """Import what recipes import, before any fork."""
    for name in names:
        sys.path.insert(0, str(ROOT / "recipes"))
        importlib.import_module(name)
        del sys.path[0]


def reading_in_process():
    """A patch by which dumps are read in the process that wants them, which need not start another one for it."""
    from dirl.scenes.io import read

    # `patch` fails if there is nothing of that name.
    return patch.object(read, "read_apart", lambda paths: map(read.read_contents, paths))


def compose_once():
    """A patch by which Hydra composes a configuration once; it else does so before to look for ``hydra.mode``."""
    from hydra._internal.hydra import Hydra

    get_mode = Hydra.get_mode

    def given_mode(hydra, config_name, overrides):
        return get_mode(hydra, config_name, overrides) if "hydra.mode" in "".join(overrides) else None

    return patch.object(Hydra, "get_mode", given_mode)


def no_pictures(patch=setattr):
    """Leave the pictures empty, which take most of a short run's time."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    from dirl.reporting import pictures, trajectories

    patch(FigureCanvasAgg, "draw", leave_empty)
    for module, name in ((pictures, "draw_policy"), (trajectories, "draw_trajectories"), (pictures, "write_gif")):
        patch(module, name, empty_file)


def empty_file(*arguments, **options):
    """In place of what draws a picture of a scene: an image of one pixel, in the file that is among the arguments."""
    from PIL import Image

    (file,) = (argument for argument in arguments if isinstance(argument, Path))
    Image.new("RGB", (1, 1)).save(file)


def leave_empty(canvas):
    """In place of matplotlib's ``draw``: pictures of the right size with nothing in them, which loggers can read."""
    canvas.get_renderer()


def processor_seconds(pid):
    """What a process has taken so far; 0 if there is none."""
    try:
        numbers = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(numbers[11]) + int(numbers[12])) / os.sysconf("SC_CLK_TCK")


def as_new(environment, pictures):
    """In a child of the server: be as a new interpreter would be that was started in an environment."""
    os.setsid()
    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.environ.clear()
    os.environ.update(environment)
    paths = environment.get("PYTHONPATH", "").split(os.pathsep)
    sys.path[1:1] = [path for path in paths if path and path not in sys.path]
    if not pictures:
        no_pictures()


def _become(folder, words, files, prepare):
    """Be the recipe, and end as the interpreter would."""
    status = 1
    try:
        os.chdir(folder)
        for number, file in zip((1, 2), files, strict=True):
            os.dup2(os.open(file, os.O_WRONLY | os.O_APPEND), number)
        sys.stdout, sys.stderr = (open(number, "w", closefd=False) for number in (1, 2))  # noqa: SIM115
        sys.argv = words
        sys.path.insert(0, os.path.dirname(words[0]))
        prepare()
        runpy.run_path(sys.argv[0], run_name="__main__")
        status = 0
    except SystemExit as error:
        if isinstance(error.code, str):
            print(error.code, file=sys.stderr)
        status = error.code if isinstance(error.code, int) else int(error.code is not None)
    except BaseException:
        traceback.print_exc()
    finally:
        try:
            threading._shutdown()
            atexit._run_exitfuncs()
            sys.stdout.flush()
            sys.stderr.flush()
        finally:
            os._exit(status)
