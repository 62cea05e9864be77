"""Checkpoints: written completely, with a digest, and checked before anything is built from them.

A checkpoint is the archive that ``torch.save`` writes, with a comment at its end, ``dirl sha256 <hex>``: the digest of
all bytes before the hexadecimal digits. (The archive's own checksums leave its directory unprotected, and torch
does not compare those of the data.) It stays a file that ``torch.load(..., weights_only=True)`` reads. Safetensors with
JSON beside was the alternative: neither has a digest, tensors that share memory would be stored twice, and optimisers'
states, with whole numbers as keys and tuples, would need a format of their own.
"""

import hashlib
import io
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch

from dirl.runs.paths import RunError, State, check_entries, find_checkpoint, training_checkpoints
from dirl.scenes.io.atomic import atomic_path
from dirl.scenes.io.bounded import MOST_WEIGHTS, read_bytes, unpack_tensors

SEAL = b"dirl sha256 "
DIGITS = 64
"""Of the digest, which ends the file."""


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
        return {key: _by_itself(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_by_itself(one) for one in value]
    is_view = isinstance(value, torch.Tensor) and value.untyped_storage().nbytes() > value.nbytes
    return value.clone() if is_view else value


def load_checkpoint(path: str | Path) -> State:
    """Read a checkpoint; no code in it is ever run.

    Args:
        path: a ``.pt`` file, or the folder of a run for its final weights, or the latest that is whole if it is not
            finished; or the name of an agent in `dirl.runs.paths.AGENTS`.

    Raises:
        RunError: there is none, or it is damaged.
    """
    found = find_checkpoint(path)
    if found.is_file():
        return read_checkpoint(found)
    return latest_checkpoint(found)[0]


def latest_checkpoint(folder: Path, check: Callable[[Path, State], None] = lambda *_: None) -> tuple[State, list[Path]]:
    """Return the latest usable training checkpoint of a run, and those after it, each named on the terminal.

    Args:
        folder: of the run.
        check: raises `RunError` for a file and its content that the run cannot have written.

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
    """Read a checkpoint file whose digest is right.

    Raises:
        RunError: it is damaged, or no checkpoint of this version of dirl.
    """
    try:
        data = read_bytes(file, MOST_WEIGHTS)
    except ValueError as error:
        raise RunError(str(error)) from None
    _check_digest(data, file)
    try:
        state = unpack_tensors(data)
    except Exception as error:  # zipfile and torch raise many kinds for what they cannot read
        reason = f"{type(error).__name__}: {error}".splitlines()[0][:200]
        raise RunError(f"{file}: is no checkpoint of dirl ({reason})") from None
    return check_entries(state, file)


@contextmanager
def restoring(origin: Path) -> Iterator[None]:
    """Within this context a run takes over a saved state; what does not fit is told in one line.

    Raises:
        RunError: the state does not fit.
    """
    try:
        yield
    except (ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError) as error:
        reason = f"{type(error).__name__}: {' '.join(str(error).split())}"[:300]
        raise RunError(f"{origin}: its checkpoint does not fit this run ({reason})") from None


def _check_digest(data: bytes, file: Path) -> None:
    """Raise `RunError` unless the file is an archive that ends with the digest of what stands before it."""
    body, digest = memoryview(data)[:-DIGITS], data[-DIGITS:]
    if not data.startswith(b"PK\3\4") or body[-len(SEAL) :] != SEAL:
        raise RunError(f"{file}: is damaged or no checkpoint of this version of dirl: it does not end with a digest")
    if hashlib.sha256(body).hexdigest().encode() != digest:
        raise RunError(f"{file}: is damaged: its digest differs from that of its content")
