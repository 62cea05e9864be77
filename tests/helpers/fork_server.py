"""Recipes for tests, as `forks` runs them, forked from a process that does nothing but import and fork.

pytest itself cannot fork them: what a test did to its process, and the threads that torch started there, would be in
the child. Each process of pytest starts a server when it first needs one, and asks it for one thing after the other:
one that has imported the recipes, and one for the command ``dirl``, which has imported what refuses options.
"""

import atexit
import functools
import importlib
import json
import os
import signal
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

from forks import Child, Ended, no_pictures, reading_in_process, warm_up


class Started:
    """A recipe that is running; the pictures of a training are left empty.

    Args:
        folder: where it runs.
        name: of the recipe; ``dirl`` for the command, whose last line of errors says whether torch was imported.
        arguments: of its command line.
    """

    def __init__(self, folder, name, *arguments):
        words = [str(argument) for argument in arguments]
        self.server = _server("start" if name == "dirl" else "recipes")
        self.pid = self._ask({"folder": str(folder), "name": name, "arguments": words, "environment": dict(os.environ)})

    def send_signal(self, number):
        """Send it a signal."""
        os.kill(self.pid, number)

    def wait(self):
        """Wait for its end, for which it has two minutes of processor time."""
        return Ended(**self._ask({"pid": self.pid}))

    def _ask(self, request):
        """What the server answers."""
        print(json.dumps(request), file=self.server.stdin, flush=True)
        return json.loads(self.server.stdout.readline())


@functools.cache
def _server(imported):
    command = [sys.executable, __file__, imported]
    server = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True)
    atexit.register(server.communicate)  # which closes its input, so that it ends
    return server


def _serve(imported):
    if imported == "start":
        importlib.import_module("dirl.cli.help")
    else:
        warm_up("train", "evaluate", "report", "scenes", "benchmark")
        reading_in_process().start()
    children = {}
    for line in sys.stdin:
        request = json.loads(line)
        if "pid" in request:
            answer = asdict(children.pop(request["pid"]).wait())
        else:
            environment = request.pop("environment")
            child = Child(
                Path(request["folder"]),
                request["name"],
                *request["arguments"],
                prepare=functools.partial(_start, request["name"], environment),
            )
            children[child.pid], answer = child, child.pid
        print(json.dumps(answer), flush=True)


def _start(name, environment):
    """In a child: be as a new interpreter would be that was started in an environment."""
    os.setsid()
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.environ.clear()
    os.environ.update(environment)
    paths = environment.get("PYTHONPATH", "").split(os.pathsep)
    sys.path[1:1] = [path for path in paths if path and path not in sys.path]
    if name == "train":
        no_pictures()
    if name == "dirl":
        atexit.register(lambda: print("torch" in sys.modules, file=sys.stderr))


if __name__ == "__main__":
    _serve(*sys.argv[1:])
