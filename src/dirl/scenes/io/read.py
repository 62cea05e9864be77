"""Scene dumps: one HDF5 file a scene, in the layout of the published target-driven navigation code and ours.

| dataset | shape | meaning |
|---|---|---|
| ``graph`` | integer ``[N, 4]`` | next state for ahead, right, left, back; -1 = blocked |
| ``location`` | number ``[N, 2]`` | x, z in metres |
| ``rotation`` | number ``[N]`` | heading in degrees |
| ``resnet_feature`` | float16 or float32 ``[N, D]`` or ``[N, k, D]`` | features; of ``k`` crops the first is used |
| ``patches`` | float16 ``[N, cells, channels]`` | features of the parts of each view (our files); contiguous |
| ``look_feature`` | float16 ``[K, N, D]`` | features of K further looks of each state (our files); contiguous |
| ``look_patches`` | float16 ``[K, N, cells, channels]`` | their patches; contiguous |
| ``along_feature`` | float16 ``[N, D]`` | features along each state's arrow (our tours); contiguous |
| ``toward`` | float16 ``[2, N, N]`` | how clearly each arrow leads to each state, see `Scene` (our tours); contiguous |
| ``shortest_path_distance`` | number ``[N, N]`` | ignored: distances are always recomputed |
| ``observation`` | uint8 ``[N, H, W, 3]`` | raw views (published files) |
| ``observation_webp`` | N byte strings | encoded views (our files): WebP, PNG or JPEG |

``graph``, ``location`` and ``rotation`` are required. File attributes, all optional: ``name``, ``source``, ``goals``
and ``actions`` (the order of the columns of ``graph``, if not the one above). Attributes of ``resnet_feature``:
``extractor``, ``preprocessing``, ``weights``; of ``patches``: ``extractor``, ``projection``. Attribute ``digest`` of
the file and of ``graph``, which all files that dirl writes have: a SHA-256 over all of these; a file that differs from
it is refused.

libhdf5 can crash, hang or take all memory on a damaged file. So files that are not known to be intact are read in a
separate process, which runs this file as a program: it has a limit of processor time and of memory, and if it ends, the
program that wanted the file goes on with one line about it. That process does without torch. This is no protection
against a file that was made to take over the process that reads it.
"""

import hashlib
import json
import math
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from dirl.scenes.io.files import file_digest
from dirl.scenes.io.hdf5 import Contents, read_contents
from dirl.scenes.scene import Scene, SceneError
from dirl.scenes.views import FileViews

ROOMS = Path(__file__).parents[1] / "data"
"""The built-in rooms: synthetic, with the names, state counts and goals of the published scenes."""

SUMS = "9a70f98597b4e964880ff6ac12210c4a228949e0dbc630e089535eba6dd04a46"
"""The SHA-256 of ``SHA256SUMS``, the list of their hashes."""


@dataclass(frozen=True)
class Dump:
    """A file to be read."""

    path: Path
    name: str | None = None
    """Of the scene; the file's attribute ``name`` or its stem if left out."""
    source: str | None = None
    """Its origin; the file's attribute ``source`` or "unlabelled" if left out."""


def read_dump(path: str | Path) -> Scene:
    """Read one scene from its HDF5 file, and check it.

    Raises:
        SceneError: the file is missing, damaged or invalid. The message names the file,
            the dataset, and the first offending state.
    """
    return read_dumps([Dump(Path(path))])[0]


def read_dumps(dumps: Sequence[Dump]) -> list[Scene]:
    """Read several scenes, see `read_dump`; one separate process reads all that are no built-in rooms."""
    for dump in dumps:
        if not dump.path.is_file():
            raise SceneError(f"{dump.path}: there is no such file")
    intact = [_is_intact_room(dump.path) for dump in dumps]
    unknown = [dump.path.absolute() for dump, known in zip(dumps, intact, strict=True) if not known]
    apart = read_apart(unknown) if unknown else iter(())
    scenes = []
    for dump, known in zip(dumps, intact, strict=True):
        try:
            contents = read_contents(dump.path, intact=True) if known else next(apart)
        except SceneError as error:
            raise SceneError(f"{dump.path}: {error}") from None
        mapped: dict[str, np.ndarray] = {
            array: np.memmap(dump.path, dtype, "r", offset, tuple(shape))
            for array, (offset, shape, dtype) in contents.pop("mapped").items()
        }
        if "features" in mapped and mapped["features"].ndim == 3:
            mapped["features"] = mapped["features"][:, 0]  # the first crop
        beside = dump.path.with_suffix(".patches.npy")
        if known and "patches" not in mapped and beside.is_file() and _is_intact_room(beside):
            mapped["patches"] = np.load(beside, mmap_mode="r", allow_pickle=False)
        views = {key.removeprefix("view_"): contents.pop(key) for key in [*contents] if key.startswith("view_")}
        # A file may have any name; that of a scene stands in paths, in pictures and on command lines.
        stem = re.sub(r"[^\w .,()+-]+", "_", dump.path.stem).strip("_ .,(+-")
        about: Contents = {
            "name": dump.name or contents["name"] or stem or "scene",
            "source": dump.source or contents["source"] or "unlabelled",
            "goals": tuple(contents["goals"]),
            "origin": str(dump.path),
            "views": FileViews(dump.path.resolve(), **views) if views else None,
        }
        scenes.append(Scene(**{**contents, **mapped, **about}))
    return scenes


def _is_intact_room(path: Path) -> bool:
    """Return True if a file is one of the built-in rooms; `SceneError` if it is, but not as it was installed."""
    sums = ROOMS / "SHA256SUMS"
    if path.resolve().parent != ROOMS.resolve() or not sums.is_file():
        return False
    content = sums.read_bytes()
    if hashlib.sha256(content).hexdigest() != SUMS:
        raise SceneError(f"{sums}: is not the list of hashes that was installed; install dirl again")
    digests = {name: digest for digest, name in map(str.split, content.decode().splitlines())}
    if path.name in digests and file_digest(path) != digests[path.name]:
        raise SceneError(f"{path}: is not the built-in room that was installed (SHA-256 differs); install dirl again")
    return path.name in digests


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
                arrays = dict(stored)
            values = json.loads(str(arrays.pop("json")))
            if "error" in values:
                raise SceneError(values["error"])
            for array in arrays.values():
                array.setflags(write=False)
            yield {**values, **arrays}


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
    """Write an ``.npz`` for each call, whole or not at all; runs in the separate process."""
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
