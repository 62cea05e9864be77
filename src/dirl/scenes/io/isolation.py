"""Reading dumps in a separate process.

libhdf5 can crash, hang or take all memory on a damaged file. The process that reads it has a limit of processor time
and of memory, and if it ends, the program that wanted the file goes on with one line about it. That process starts
with h5py and NumPy only. This is no protection against a file that was made to take over the process that reads it.
"""

import io
import json
import math
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dirl.scenes.io.hdf5 import Contents
from dirl.scenes.scene import SceneError

MEMORY = 3 * 2**30
"""Bytes of address space of the process that reads. (On Linux only.)"""
SECONDS, SECONDS_A_MEGABYTE = 30.0, 1.0
"""Of processor time for a file. Views are decoded, which takes most of it."""
PATIENCE = 20
"""How much longer by the clock the whole may take: the machine may be busy, or its disk slow."""

PROGRAM = Path(__file__).with_name("child.py")


def read_apart(paths: Sequence[Path]) -> Iterator[Contents]:
    """Read dumps, all of them in one separate process.

    Raises:
        SceneError: a file cannot be read. The message does not name the file; the caller knows it.
    """
    tasks = [{"task": "read", "path": os.path.abspath(path), "seconds": seconds_for(path)} for path in paths]
    for header, arrays in _answers(tasks):
        yield Contents(**{**header["values"], **arrays})


def replace_features_apart(
    dump: Path, path: Path, arrays: dict[str, str], attributes: dict[str, dict[str, str]]
) -> None:
    """Let another process do `dirl.scenes.io.write.copy_with`, with each array in a ``.npy`` file.

    Raises:
        SceneError: the dump cannot be read, or the file not written.
    """
    files = {"dump": os.path.abspath(dump), "path": os.path.abspath(path), "arrays": arrays}
    task = {"task": "replace_features", **files, "attributes": attributes, "seconds": seconds_for(dump)}
    for _ in _answers([task]):
        pass


def seconds_for(path: Path) -> float:
    """The processor time that reading a file may take."""
    return SECONDS + SECONDS_A_MEGABYTE * path.stat().st_size / 1e6


def _answers(tasks: Sequence[dict[str, Any]]) -> Iterator[tuple[dict[str, Any], dict[str, NDArray[Any]]]]:
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(entry for entry in sys.path if entry),
        "OPENBLAS_NUM_THREADS": "1",  # its threads take time to start, and address space
    }
    try:
        # -S: `sys.path` is that of this process, and what site does takes time; -P: modules here hide no others.
        ended = subprocess.run(
            [sys.executable, "-S", "-P", str(PROGRAM)],
            input=json.dumps({"memory": MEMORY, "tasks": tasks}).encode(),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
            timeout=PATIENCE * sum(task["seconds"] for task in tasks),
        )
        status, output = ended.returncode, io.BytesIO(ended.stdout)
    except subprocess.TimeoutExpired as late:
        status, output = -getattr(signal, "SIGKILL", 0), io.BytesIO(late.stdout or b"")
    for task in tasks:
        try:
            answer = _receive(output)
        except EOFError:
            raise SceneError(_ended(status, task["seconds"])) from None
        if "error" in answer[0]:
            raise SceneError(answer[0]["error"])
        yield answer


def _receive(stream: io.BytesIO) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """The next answer: a line of JSON, and the arrays that it lists."""
    line = stream.readline()
    if not line.endswith(b"\n"):
        raise EOFError
    header = json.loads(line)
    arrays = {}
    for name, (kind, shape) in header.get("arrays", {}).items():
        size = math.prod(shape) * np.dtype(kind).itemsize
        data = stream.read(size)
        if len(data) < size:
            raise EOFError
        arrays[name] = np.frombuffer(data, kind).reshape(shape)
    return header, arrays


def _ended(status: int, seconds: float) -> str:
    """Why the process that reads ended before it had answered."""
    if status == -getattr(signal, "SIGXCPU", 0):
        return f"was not read after {seconds:.0f} s of processor time; it is damaged"
    if status == -getattr(signal, "SIGKILL", 0):
        return "the process that read it was killed: it took too long, or the machine's memory is full"
    try:
        how = signal.Signals(-status).name
    except ValueError:
        how = f"exit status {status}"
    return f"libhdf5 failed on it ({how}); it is damaged"
