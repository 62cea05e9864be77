"""Folders of runs, and their checkpoints: written completely, with a digest, and checked before they are used.

A checkpoint is the archive that ``torch.save`` writes, with a comment at its end, ``dirl sha256 <hex>``: the digest of
all bytes before the hexadecimal digits. (The archive's own checksums leave its directory unprotected, and torch
does not compare those of the data.) It stays a file that ``torch.load(..., weights_only=True)`` reads. Safetensors with
JSON beside was the alternative: neither has a digest, tensors that share memory would be stored twice, and optimisers'
states, with whole numbers as keys and tuples, would need a format of their own.
"""

import hashlib
import io
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any

import torch
from annotated_types import Ge, MinLen

from dirl.scenes.io.files import MOST_WEIGHTS, atomic_path, checked, read_bytes, unpack_tensors
from dirl.scenes.scene import SceneError

PRETRAINED = Path(__file__).parents[1] / "pretrained"
"""Trained agents that come with the package, each in the folder of its name."""

ARCHITECTURE = ("observation", "encoder", "memory", "heads", "policy", "network")
"""The options that decide which weights a policy has, and what they read."""

State = dict[str, Any]
"""A checkpoint by entry: ``network``, the weights, `Stated`, and of a training what its loop goes on from."""

Facts = dict[str, Any]
"""What is said of a run, for its summary."""

Summary = Mapping[str, Any]
"""What ``summary.json`` holds: facts of the run, and measures by policy, scene and goal."""

SCHEMA = 2
"""Of configurations and checkpoints."""

SEAL = b"dirl sha256 "
DIGITS = 64
"""Of the digest, which ends the file."""


@dataclass(frozen=True)
class Stated:
    """What every checkpoint says of its weights."""

    config: str
    extractor: str
    scenes: Annotated[tuple[str, ...], MinLen(1)]
    views: Annotated[tuple[str, ...], MinLen(1)]
    """What the four images of an observation show, in their order."""
    frames: Annotated[int, Ge(0)]
    schema: int
    turns: tuple[Annotated[int, Ge(4)], ...] = (4,)
    """Right turns in a full circle, in the scenes of the training."""


CONFIG_FILE = "config.yaml"
"""Of a run, by which its folder is recognised."""

TABLES = ("dagger.csv", "evaluation.csv", "imitation.csv", "reinforcement.csv")
"""What a training writes rows to; other files of its folder are left alone."""


class RunError(ValueError):
    """A run folder or checkpoint that cannot be used."""


def is_finished(folder: Path) -> bool:
    """Return True if a folder holds a finished run."""
    return (folder / "summary.json").exists() and not training_checkpoints(folder)


def training_checkpoints(folder: Path) -> list[Path]:
    """Return the checkpoints from which an unfinished run can be resumed, oldest first."""
    return sorted(file for file in (folder / "checkpoints").glob("*.pt") if file.stem.isdecimal())


def packaged_agent(name: str | Path) -> Path | None:
    """Return the folder of an agent in `PRETRAINED`; None if there is none, or the name is in the present folder."""
    path = Path(name)
    return PRETRAINED / path if not path.exists() and path.name == str(name) and (PRETRAINED / path).is_dir() else None


def save_checkpoint(file: Path, state: State) -> None:
    """Write a checkpoint so that the file is either complete or absent, whenever the process is killed."""
    buffer = io.BytesIO()
    torch.save(_by_itself(dict(state)), buffer)
    archive = buffer.getbuffer()[:-2]  # without the length of its comment, which is none
    length = (len(SEAL) + DIGITS).to_bytes(2, "little")
    digest = hashlib.sha256(archive)
    digest.update(length + SEAL)
    file.parent.mkdir(exist_ok=True)
    with atomic_path(file) as temporary, temporary.open("wb") as stream:
        stream.write(archive)
        stream.write(length + SEAL + digest.hexdigest().encode())


def _by_itself(value: Any) -> Any:
    """Return the same with copies of tensors that are views, of which torch would write the whole."""
    if isinstance(value, dict):
        return {key: _by_itself(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_by_itself(inner) for inner in value]
    is_view = isinstance(value, torch.Tensor) and value.untyped_storage().nbytes() > value.nbytes
    return value.clone() if is_view else value


def load_checkpoint(path: str | Path) -> State:
    """Read a checkpoint; no code in it is ever run.

    Args:
        path: a ``.pt`` file, or the folder of a run for its final weights, or the latest that is whole if it is not
            finished; or the name of an agent in `dirl.runs.checkpoints.PRETRAINED`.

    Raises:
        RunError: there is none, or it is damaged.
    """
    path = packaged_agent(path) or Path(path)
    file = path / "network.pt" if path.is_dir() else path
    if file.is_file():
        return read_checkpoint(file)
    if path.is_dir() and training_checkpoints(path):
        return latest_checkpoint(path)[0]
    raise RunError(f"{path}: holds no checkpoint; expected the folder of a run or a .pt file")


def latest_checkpoint(folder: Path, check: Callable[[Path, State], None] = lambda *_: None) -> tuple[State, list[Path]]:
    """Return the latest usable training checkpoint of a run, and those after it, each named on the terminal.

    ``check`` raises `RunError` for a file and its content that the run cannot have written.

    Raises:
        RunError: none can be used.
    """
    files = training_checkpoints(folder)
    for number in reversed(range(len(files))):
        try:
            state = read_checkpoint(files[number])
            check(files[number], state)
            return state, files[number + 1 :]
        except RunError as error:
            if number == 0:
                raise RunError(f"{error}; to begin this run again from its start, delete {files[0].parent}") from None
            print(f"{error}; going back to the one before, {files[number - 1].name}", file=sys.stderr, flush=True)
    raise RunError(f"{folder}: holds no checkpoint of a training")


def read_checkpoint(file: Path) -> State:
    """Read a checkpoint file. It says of its weights what every one says; they are loaded strictly.

    Raises:
        RunError: it is damaged, is no checkpoint, or another version of dirl wrote it.
    """
    stored = read_archive(file)
    held: State = dict(stored) if isinstance(stored, dict) else {}
    if "network" not in held:
        raise RunError(f"{file}: is no checkpoint of dirl: it has no network")
    if held.get("schema") != SCHEMA:
        raise RunError(f"{file}: was written by another version of dirl (schema {held.get('schema')}, not {SCHEMA})")
    names = [field.name for field in fields(Stated)]
    try:
        checked({name: held[name] for name in names if name in held}, Stated)
    except SceneError as error:
        raise RunError(f"{file}: is no checkpoint of dirl: {error}") from None
    return held


def read_archive(file: Path) -> Any:
    """Return what `save_checkpoint` wrote to a file, if its digest is right; `RunError` if it is damaged."""
    try:
        data = read_bytes(file, MOST_WEIGHTS)
    except ValueError as error:
        raise RunError(str(error)) from None
    body, digest = memoryview(data)[:-DIGITS], data[-DIGITS:]
    if not data.startswith(b"PK\3\4") or body[-len(SEAL) :] != SEAL:
        raise RunError(f"{file}: is damaged or no checkpoint of this version of dirl: it does not end with a digest")
    if hashlib.sha256(body).hexdigest().encode() != digest:
        raise RunError(f"{file}: is damaged: its digest differs from that of its content")
    try:
        return unpack_tensors(data)
    except Exception as error:  # zipfile and torch raise many kinds for what they cannot read
        reason = f"{type(error).__name__}: {error}".splitlines()[0][:200]
        raise RunError(f"{file}: is no checkpoint of dirl ({reason})") from None


@contextmanager
def restoring(origin: Path) -> Iterator[None]:
    """Report what of a saved state does not fit, while a run takes it over within this context, in one line.

    Raises:
        RunError: the state does not fit.
    """
    try:
        yield
    except (ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError) as error:
        reason = f"{type(error).__name__}: {' '.join(str(error).split())}"[:300]
        raise RunError(f"{origin}: its checkpoint does not fit this run ({reason})") from None
