"""Reading dumps in a separate process, which runs this file as a program.

libhdf5 can crash, hang or take all memory on a damaged file. The process that reads it has a limit of processor time
and of memory, and if it ends, the program that wanted the file goes on with one line about it. That process does
without torch. This is no protection against a file that was made to take over the process that reads it.
"""

import json
import math
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from dirl.scenes.scene import SceneError

MEMORY = 3 * 2**30
"""Bytes of address space of the process that reads. (On Linux only.)"""
SECONDS, SECONDS_A_MEGABYTE = 30.0, 1.0
"""Of processor time for a file. Views are decoded, which takes most of it."""
PATIENCE = 20
"""How much longer by the clock the whole may take: the machine may be busy, or its disk slow."""

PROGRAM = Path(__file__)


def read_apart(paths: Sequence[Path]) -> Iterator[dict[str, Any]]:
    """Yield what `dirl.scenes.io.hdf5.read_contents` returns for each dump, all of them read in one separate process.

    Raises:
        SceneError: of that function, or because it did not return. The message does not name the dump.
    """
    seconds = [SECONDS + SECONDS_A_MEGABYTE * path.stat().st_size / 1e6 for path in paths]
    with TemporaryDirectory() as folder:
        request = {"paths": [str(path) for path in paths], "folder": os.path.abspath(folder)}
        status = _run({**request, "seconds": seconds, "memory": MEMORY}, PATIENCE * sum(seconds))
        for number, allowed in enumerate(seconds):
            answer = Path(folder) / f"{number}.npz"
            if not answer.is_file():
                raise SceneError(why_ended(status, allowed, "libhdf5"))
            with np.load(answer, allow_pickle=False) as stored:
                found = dict(stored)
            values = json.loads(str(found.pop("json")))
            if "error" in values:
                raise SceneError(values["error"])
            for array in found.values():
                array.setflags(write=False)
            yield {**values, **found}


def _run(request: dict[str, object], patience: float) -> int:
    try:
        # -S: `sys.path` is that of this process, and what site does takes time; -P: modules here hide no others.
        return subprocess.run(
            [sys.executable, "-S", "-P", str(PROGRAM)],
            input=json.dumps(request).encode(),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=environment(),
            timeout=patience,
        ).returncode
    except subprocess.TimeoutExpired:
        return -getattr(signal, "SIGKILL", 0)


def environment() -> dict[str, str]:
    """Return the environment of a process that reads a file for this one."""
    paths = os.pathsep.join(entry for entry in sys.path if entry)
    # The threads of OpenBLAS take time to start, and address space.
    return {**os.environ, "PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1"}


def why_ended(status: int, seconds: float, reader: str) -> str:
    """Return why the process that reads ended before it had answered."""
    if status == -getattr(signal, "SIGXCPU", 0):
        return f"was not read after {seconds:.0f} s of processor time; it is damaged"
    if status == -getattr(signal, "SIGKILL", 0):
        return "the process that read it was killed: it took too long, or the machine's memory is full"
    how = f"exit status {status}" if status >= 0 else signal.Signals(-status).name
    return f"{reader} failed on it ({how}); it is damaged"


def main() -> None:
    """In the separate process: write an ``.npz`` for each call, whole or not at all."""
    from dirl.scenes.io.hdf5 import read_contents

    request = json.load(sys.stdin)
    limit("RLIMIT_AS", request["memory"])
    for number, (path, seconds) in enumerate(zip(request["paths"], request["seconds"], strict=True)):
        limit("RLIMIT_CPU", seconds + sum(os.times()[:2]))
        try:
            answer = read_contents(path)
        except (SceneError, OSError, MemoryError) as error:
            answer = {"error": str(error) if isinstance(error, SceneError) else f"{type(error).__name__}: {error}"}
        arrays: dict[str, Any] = {name: value for name, value in answer.items() if isinstance(value, np.ndarray)}
        values = {name: value for name, value in answer.items() if name not in arrays}
        unfinished = Path(request["folder"]) / "unfinished.npz"
        np.savez(unfinished, json=json.dumps(values), **arrays)
        unfinished.rename(unfinished.with_name(f"{number}.npz"))


def limit(what: str, value: float) -> None:
    """Limit this process, where the operating system can (Windows cannot, macOS only the time)."""
    with suppress(ImportError, ValueError, OSError):
        import resource

        kind = getattr(resource, what)
        hard = resource.getrlimit(kind)[1]
        soft = math.ceil(value)
        resource.setrlimit(kind, (soft if hard < 0 else min(soft, hard), hard))


if __name__ == "__main__":
    main()
