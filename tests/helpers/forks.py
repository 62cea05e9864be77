"""Recipes run again and again without the seconds that their imports take: each in a fork of one process.

A child is what ``python recipes/<name>.py <arguments>`` would be, after its imports.
"""

import atexit
import importlib
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


def recipe_file(name):
    """The program of that name: a recipe, the benchmark, or the command ``dirl``."""
    return ROOT / "src/dirl/cli/main.py" if name == "dirl" else ROOT / "recipes" / f"{name}.py"


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
    """

    def __init__(self, folder, name, *arguments, prepare=lambda: None):
        words = [str(argument) for argument in arguments]
        self.files = [tempfile.TemporaryFile() for _ in ("printed", "errors")]  # noqa: SIM115
        sys.stdout.flush()
        sys.stderr.flush()
        self.pid = os.fork()
        if self.pid == 0:
            _become(folder, recipe_file(name), words, self.files, prepare)

    def kill(self, number=signal.SIGKILL):
        """Send it a signal."""
        os.kill(self.pid, number)

    def wait(self, timeout=120.0, patience=5):
        """Wait for its end; stop it after so many processor seconds, or ``patience`` times as many of the clock."""
        began, ended = time.monotonic(), 0
        while not ended:
            ended, status = os.waitpid(self.pid, os.WNOHANG)
            if not ended and (processor_seconds(self.pid) > timeout or time.monotonic() - began > patience * timeout):
                self.kill()
                os.waitpid(self.pid, 0)
                return Ended(None, *self._texts())
            time.sleep(0.01)
        return Ended(os.waitstatus_to_exitcode(status), *self._texts())

    def _texts(self):
        texts = []
        for file in self.files:
            file.seek(0)
            texts.append(file.read().decode(errors="replace").removeprefix("loading ...\n"))
            file.close()
        return texts


def run(folder, name, *arguments, prepare=lambda: None, timeout=120.0, patience=5):
    """Run a recipe to its end, see `Child`."""
    return Child(folder, name, *arguments, prepare=prepare).wait(timeout, patience)


def warm_up(*names):
    """Import what recipes import, before any fork."""
    for name in names:
        sys.path.insert(0, str(recipe_file(name).parent))
        importlib.import_module(name)
        del sys.path[0]


def reading_in_process():
    """A patch by which dumps are read in the process that wants them, which need not start another one for it."""
    from dirl.scenes.io import read

    # `patch` fails if there is nothing of that name.
    return patch.object(read, "read_apart", lambda paths: map(read.read_contents, paths))


def no_pictures():
    """Leave the pictures empty, which take most of a short run's time."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    from dirl.reporting import pictures, trajectories

    FigureCanvasAgg.draw = leave_empty
    pictures.draw_policy = trajectories.draw_trajectories = pictures.write_gif = empty_file


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


def _become(folder, file, arguments, streams, prepare):
    """Be the recipe, and end as the interpreter would."""
    status = 1
    try:
        os.chdir(folder)
        for number, stream in zip((1, 2), streams, strict=True):
            os.dup2(stream.fileno(), number)
        sys.stdout, sys.stderr = (open(number, "w", closefd=False) for number in (1, 2))  # noqa: SIM115
        sys.argv = [str(file), *arguments]
        sys.path.insert(0, str(file.parent))
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
