"""Files that are complete or absent, even if the process is killed, the disk is full or the power fails; digests."""

import hashlib
import json
import math
import os
import secrets
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

DIGEST = "digest"
"""The key in JSON, see `sealed`."""

PREFIX = ".unfinished-"
"""What the names of temporary files begin with; only a killed process leaves one."""


@contextmanager
def atomic_path(file: str | Path) -> Iterator[Path]:
    """Within this context a file is written under a temporary name; at its end it is renamed.

    It yields the path to write to. An existing file is replaced, and stays unchanged if anything fails.

    The temporary name is in the same folder, because a rename across file systems is a copy; it is random, so that two
    processes cannot write to the same one; and it ends like the file's own, because many libraries take the format
    from it. The data is on the disk (``fsync``) before the rename, and the rename before the context ends.

    Raises:
        OSError: the file cannot be written; names ``file``, not the temporary one.
    """
    target = Path(os.path.realpath(file))  # a symbolic link stays one
    temporary = target.with_name(f"{PREFIX}{secrets.token_hex(8)}{target.suffix}")
    try:
        yield temporary
        _flush_to_disk(temporary)
        os.replace(temporary, target)
        if os.name == "posix":  # elsewhere a folder cannot be opened
            _flush_to_disk(target.parent, os.O_RDONLY)
    except BaseException as error:
        with suppress(OSError):
            temporary.unlink()
        if isinstance(error, OSError) and error.errno is not None and error.filename in (None, str(temporary)):
            raise OSError(error.errno, error.strerror, str(file)) from error
        raise


def _flush_to_disk(path: Path, flags: int = os.O_RDWR) -> None:
    descriptor = os.open(path, flags)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_text(file: Path, text: str) -> None:
    """Write a text file in UTF-8, completely or not at all."""
    with atomic_path(file) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(file: Path, data: object) -> None:
    """Write a JSON file, completely or not at all; NaN and infinity, which JSON lacks, become null."""

    def plain(value: object) -> object:
        if isinstance(value, Mapping):
            return {key: plain(inner) for key, inner in value.items()}
        if isinstance(value, list | tuple):
            return [plain(inner) for inner in value]
        return None if isinstance(value, float) and not math.isfinite(value) else value

    write_text(file, json.dumps(plain(data), indent=1, allow_nan=False) + "\n")


def remove_unfinished(folder: Path) -> None:
    """Delete the temporary files that killed processes have left in a folder."""
    for file in folder.glob(f"{PREFIX}*"):
        file.unlink(missing_ok=True)


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a file's bytes, as hexadecimal digits."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def sealed(facts: Mapping[str, object], *contents: bytes) -> dict[str, object]:
    """Facts to be written as JSON, with a digest over them and the contents of other files of their folder."""
    digest = hashlib.sha256(json.dumps(facts, sort_keys=True).encode())
    for content in contents:
        digest.update(hashlib.sha256(content).digest())
    return {**facts, DIGEST: digest.hexdigest()}


def check_seal(facts: Mapping[str, object], *contents: bytes) -> None:
    """Check what `sealed` added, ValueError if anything is not as it was written."""
    plain = {key: value for key, value in facts.items() if key != DIGEST}
    if facts != sealed(plain, *contents):
        raise ValueError("its files are not those that were written: the digest differs")
