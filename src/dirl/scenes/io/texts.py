"""Text files that somebody else may have written: refused at once if they are huge, as a sparse file can be."""

import csv
from pathlib import Path

MOST = 64 * 2**20
"""Bytes that are read of a file. The longest table of a run has a row a step of imitation, 40 bytes each."""


def read_text(file: Path, most: int = MOST, *, encoding: str = "utf-8", errors: str = "strict") -> str:
    """The text of a file.

    Args:
        file: to read.
        most: so many bytes at most.
        encoding: of the text.
        errors: what becomes of bytes that are no text, as of ``bytes.decode``.

    Raises:
        ValueError: it is longer than ``most``, or (with ``errors="strict"``) no such text.
        OSError: it cannot be read.
    """
    with file.open("rb") as stream:
        data = stream.read(most + 1)
    if len(data) > most:
        raise ValueError(f"{file}: has more than {most} bytes, which no such file of dirl has")
    try:
        return data.decode(encoding, errors)
    except UnicodeDecodeError as error:
        raise ValueError(f"{file}: is not UTF-8 text ({error})") from None


def read_rows(file: Path) -> list[dict[str, str]]:
    """The rows of a CSV file whose first line names the columns.

    Raises:
        ValueError: it is too long, or no such table.
        OSError: it cannot be read.
    """
    try:
        return list(csv.DictReader(read_text(file).splitlines(), strict=True))
    except csv.Error as error:
        raise ValueError(f"{file}: is no table ({error})") from None
