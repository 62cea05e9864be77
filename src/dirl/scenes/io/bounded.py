"""Files that somebody else may have written: none is read, unpacked or waited for without a bound."""

import csv
import io
import os
import stat
import zipfile
from math import prod
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

MOST = 64 * 2**20
"""Bytes that are read of a file. The longest table of a run has a row a step of imitation, 40 bytes each."""

MOST_WEIGHTS = 4 * 2**30
"""Of a file of tensors: a checkpoint has three times the weights, a map a few kilobytes a place."""

FREELY_UNPACKED, MOST_RATIO = 2**28, 100
"""Arrays of more bytes may only be so many times larger than their file: gzip packs zeros a thousand times."""


def open_regular(file: Path) -> BinaryIO:
    """Open a regular file to read it; a pipe or a device, which may never end, is not waited for.

    Raises:
        ValueError: it is no regular file.
        OSError: it cannot be opened.
    """
    waiting = getattr(os, "O_NONBLOCK", 0)  # else opening a pipe waits for somebody to write
    stream = open(file, "rb", opener=lambda path, flags: os.open(path, flags | waiting))  # noqa: SIM115
    if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
        stream.close()
        raise ValueError(f"{file}: is no regular file")
    return stream


def read_bytes(file: Path, most: int = MOST) -> bytes:
    """Return the content of a regular file, see `open_regular`.

    Raises:
        ValueError: it is longer than ``most`` bytes, or no regular file.
        OSError: it cannot be read.
    """
    with open_regular(file) as stream:
        size = os.fstat(stream.fileno()).st_size
        data = stream.read(size + 1) if size <= most else b""  # a buffer of `most` may be more than there is
    if max(size, len(data)) > most:
        raise ValueError(f"{file}: has more than {most} bytes, which no such file of dirl has")
    return data


def read_text(file: Path, most: int = MOST, *, encoding: str = "utf-8", errors: str = "strict") -> str:
    """Return the text of a file, see `read_bytes`; ``errors`` as of ``bytes.decode``.

    Raises:
        ValueError: it is longer than ``most`` bytes, no regular file, or (with ``errors="strict"``) no such text.
        OSError: it cannot be read.
    """
    try:
        return read_bytes(file, most).decode(encoding, errors)
    except UnicodeDecodeError as error:
        raise ValueError(f"{file}: is not UTF-8 text ({error}); save it as UTF-8") from None


def read_rows(file: Path) -> list[dict[str, str]]:
    """Return the rows of a CSV file whose first line names the columns; ValueError if it is no such table."""
    try:
        return list(csv.DictReader(read_text(file).splitlines(), strict=True))
    except csv.Error as error:
        raise ValueError(f"{file}: is no table ({error})") from None


def read_arrays(file: Path) -> dict[str, np.ndarray]:
    """Return the arrays of an ``.npz`` file; the sizes that it declares are checked before any is unpacked.

    Raises:
        ValueError: it is no such file, is damaged, or would unpack to far more than it is.
        OSError: it cannot be read.
    """
    try:
        with open_regular(file) as stream, zipfile.ZipFile(stream) as archive:
            entries, packed = archive.infolist(), os.fstat(stream.fileno()).st_size
            if (unpacked := sum(entry.file_size for entry in entries)) > max(FREELY_UNPACKED, MOST_RATIO * packed):
                raise ValueError(f"{packed} bytes would unpack to {unpacked}")
            for entry in entries:
                _check_header(archive, entry)
            stream.seek(0)
            with np.load(stream, allow_pickle=False) as stored:
                return dict(stored)
    except OSError:
        raise
    except Exception as error:  # zipfile and numpy raise many kinds for what they cannot read
        reason = " ".join(f"{error}".split())[:200]
        raise ValueError(f"{file}: is no file of arrays that can be read ({reason or type(error).__name__})") from None


def _check_header(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> None:
    """Raise ValueError unless an array has the size that its shape says: NumPy makes room for the shape first."""
    with archive.open(entry) as member:
        version = np.lib.format.read_magic(member)
        read_header = np.lib.format.read_array_header_1_0 if version[0] == 1 else np.lib.format.read_array_header_2_0
        shape, _, dtype = read_header(member)
        if member.tell() + prod(shape) * dtype.itemsize != entry.file_size:
            raise ValueError(f"{entry.filename} is not as large as its shape {shape}")


def read_tensors(file: Path) -> Any:
    """Return what ``torch.save`` wrote, see `unpack_tensors`; `read_bytes` says what else is raised."""
    return unpack_tensors(read_bytes(file, MOST_WEIGHTS))


def unpack_tensors(data: bytes) -> Any:
    """Return what is in an archive of ``torch.save``, on the CPU; no code in it runs.

    Raises:
        ValueError: it would unpack to more than it is: torch does not compress, and a view may repeat an element.
        Exception: of torch, whatever it is for what it cannot read.
    """
    import torch  # here: the process that reads dumps does without it

    archive = io.BytesIO(data)
    if zipfile.is_zipfile(archive):  # what older versions of torch wrote is none
        parts = zipfile.ZipFile(archive).infolist()
        if sum(part.file_size for part in parts) > len(data):
            raise ValueError("its parts are larger than the file")
    archive.seek(0)
    stored = torch.load(archive, map_location="cpu", weights_only=True)
    values = stored.values() if isinstance(stored, dict) else ()
    most = max(FREELY_UNPACKED, len(data))
    if any(isinstance(value, torch.Tensor) and value.nbytes > most for value in values):
        raise ValueError("a tensor is larger than the file")
    return stored
