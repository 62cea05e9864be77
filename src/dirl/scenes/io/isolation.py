"""Reading dumps in a separate process.

libhdf5 can crash, hang or take all memory on a damaged file. The process that reads it has a limit of processor time
and of memory, and if it ends, the program that wanted the file goes on with one line about it. That process starts
with h5py and NumPy only. This is no protection against a file that was made to take over the process that reads it.
"""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dirl.scenes.scene import SceneError

MEMORY = 3 * 2**30
"""Bytes of address space of the process that reads. (On Linux only.)"""
SECONDS, SECONDS_A_MEGABYTE = 30.0, 1.0
"""Of processor time for a file. Views are decoded, which takes most of it."""
PATIENCE = 20
"""How much longer by the clock the whole may take: the machine may be busy, or its disk slow."""

PROGRAM = Path(__file__).with_name("child.py")


def read_apart(paths: Sequence[Path]) -> Iterator[dict[str, Any]]:
    """What `dirl.scenes.io.hdf5.read_contents` finds in dumps, all of them read in one separate process."""
    return _apart(paths, [{}] * len(paths))


def copy_apart(
    dump: Path, path: Path, arrays: Mapping[str, NDArray[Any]], attributes: Mapping[str, Mapping[str, str]]
) -> None:
    """Let another process do `dirl.scenes.io.write.copy_with`; raises `SceneError` as `read_apart` does."""
    with TemporaryDirectory() as folder:
        files = {name: os.path.abspath(Path(folder) / f"{name}.npy") for name in arrays}
        for name, array in arrays.items():
            np.save(files[name], array)
        list(_apart([dump], [{"copy": {"path": os.path.abspath(path), "arrays": files, "attributes": attributes}}]))


def _apart(dumps: Sequence[Path], arguments: Sequence[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """The answers of `dirl.scenes.io.child` about dumps."""
    with TemporaryDirectory() as folder:
        tasks: list[dict[str, Any]] = [
            {
                "arguments": {"dump": os.path.abspath(dump), **given},
                "answer": os.path.abspath(Path(folder) / f"{number}.npz"),
                "seconds": SECONDS + SECONDS_A_MEGABYTE * dump.stat().st_size / 1e6,
            }
            for number, (dump, given) in enumerate(zip(dumps, arguments, strict=True))
        ]
        status = _run(tasks)
        for task in tasks:
            if not os.path.isfile(task["answer"]):
                raise SceneError(_ended(status, task["seconds"]))
            yield _answer(task["answer"])


def _run(tasks: Sequence[dict[str, Any]]) -> int:
    """Start the process, and wait for its exit status."""
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(entry for entry in sys.path if entry),
        "OPENBLAS_NUM_THREADS": "1",  # its threads take time to start, and address space
    }
    try:
        # -S: `sys.path` is that of this process, and what site does takes time; -P: modules here hide no others.
        return subprocess.run(
            [sys.executable, "-S", "-P", str(PROGRAM)],
            input=json.dumps({"memory": MEMORY, "tasks": tasks}).encode(),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=environment,
            timeout=PATIENCE * sum(task["seconds"] for task in tasks),
        ).returncode
    except subprocess.TimeoutExpired:
        return -getattr(signal, "SIGKILL", 0)


def _answer(file: str) -> dict[str, Any]:
    with np.load(file, allow_pickle=False) as stored:
        found = dict(stored)
    values = json.loads(str(found.pop("json")))
    if "error" in values:
        raise SceneError(values["error"])
    for array in found.values():
        array.setflags(write=False)
    return {**values, **found}


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
