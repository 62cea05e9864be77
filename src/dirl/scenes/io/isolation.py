"""Reading dumps in a separate process.

libhdf5 can crash, hang or take all memory on a damaged file. The process that reads it has a limit of processor time
and of memory, and if it ends, the program that wanted the file goes on with one line about it. That process starts
with h5py and NumPy only. This is no protection against a file that was made to take over the process that reads it.
"""

import json
import math
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Any

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
    request = json.dumps({"memory": MEMORY, "tasks": tasks}).encode()
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(entry for entry in sys.path if entry),
        "OPENBLAS_NUM_THREADS": "1",  # its threads take time to start, and address space
    }
    # -S: `sys.path` is that of this process already, and what site does takes time; -P: modules here hide no others.
    process = subprocess.Popen(
        [sys.executable, "-S", "-P", str(PROGRAM)],
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    clock = threading.Timer(PATIENCE * sum(task["seconds"] for task in tasks), process.kill)
    clock.daemon = True
    clock.start()
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        _send(process.stdin, request)
        for task in tasks:
            try:
                answer = _receive(process.stdout)
            except EOFError:
                raise SceneError(_ended(process.wait(), task["seconds"])) from None
            if "error" in answer[0]:
                raise SceneError(answer[0]["error"])
            yield answer
    finally:
        clock.cancel()
        process.kill()
        process.stdout.close()
        process.wait()


def _send(stream: IO[bytes], request: bytes) -> None:
    try:
        with stream:
            stream.write(request)
    except BrokenPipeError:  # it has ended already, which is noticed when it does not answer
        pass


def _receive(stream: IO[bytes]) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    header = json.loads(_exactly(stream, int.from_bytes(_exactly(stream, 8), "little")))
    arrays = {}
    for name, (kind, shape) in header.get("arrays", {}).items():
        size = math.prod(shape) * np.dtype(kind).itemsize
        arrays[name] = np.frombuffer(_exactly(stream, size), kind).reshape(shape)
    return header, arrays


def _exactly(stream: IO[bytes], size: int) -> bytes:
    """That many bytes of a stream."""
    data = stream.read(size)
    if len(data) < size:
        raise EOFError
    return data


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
