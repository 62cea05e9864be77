"""Files: read with bounds and checked, because somebody else may have written them; written completely or not at all.

None is read, unpacked or waited for without a bound; what is wrong with one is told in one line. A file that is written
is complete or absent, even if the process is killed, the disk is full or the power fails.
"""

import csv
import difflib
import hashlib
import io
import json
import os
import re
import secrets
import stat
import zipfile
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import fields
from functools import cache
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, BinaryIO, get_type_hints

from dirl.scenes.errors import SceneError

if TYPE_CHECKING:
    from torch import Tensor

MOST = 64 * 2**20
"""Bytes that are read of a file. The longest table of a run has a row a step of imitation, 40 bytes each."""

MOST_WEIGHTS = 4 * 2**30
"""Of a file of tensors: a checkpoint has three times the weights, a map of a recording 50 kB a frame."""

FREELY_UNPACKED = 2**28
"""Bytes that a file may unpack to, however small it is."""


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


def read_weights(file: Path) -> "dict[str, Tensor]":
    """Return a state_dict that ``torch.save`` wrote, see `unpack_tensors`, its numbers as float32.

    Raises:
        ValueError: there is no such file, torch cannot read it, or it holds something else.
    """
    if not file.is_file():
        raise ValueError(f"{file}: there is no such file")
    try:
        stored = unpack_tensors(read_bytes(file, MOST_WEIGHTS))
        return {name: value.float() if value.is_floating_point() else value for name, value in stored.items()}
    except AttributeError:
        raise ValueError(f"{file}: is no state_dict") from None
    except Exception as error:  # what unpickling a broken file raises can be anything
        raise ValueError(f"{file}: torch cannot read it as weights ({error!r:.200})") from None


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


MOST_NAMED = 100
"""How many choices an error lists: all kinds of furniture, but not all panoramas of a large tour."""

LONGEST = 1000
"""Characters of the name of a file in another one; what is longer no operating system takes."""

UNKNOWN = "unexpected_keyword_argument"
"""What pydantic calls a key that a dataclass does not have."""

DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+")


def checked(value: object, kind: Any, where: str = "", *, strict: bool = True) -> Any:
    """Return what a file holds as a type: tables become dataclasses, lists tuples, whole numbers floats.

    Args:
        value: made of dictionaries, lists, texts and numbers.
        kind: a dataclass, whose tables are dataclasses too, or another type; bounds are those of `annotated_types`.
        where: in which file or part of it, for errors.
        strict: False takes texts as numbers too.

    Raises:
        SceneError: something is of another type, out of bounds, unknown or missing; the message names it.
    """
    from pydantic import ValidationError  # here: many commands read no such file, and this takes 0.1 s
    from pydantic_core import to_json

    try:
        # Strictly, a list of JSON can be a tuple, and an object a dataclass; those of Python cannot.
        return _adapter(kind).validate_json(to_json(value, inf_nan_mode="strings"), strict=strict, extra="forbid")
    except ValidationError as error:
        problems = error.errors(include_url=False)
    first = next((problem for problem in problems if problem["type"] == UNKNOWN), problems[0])
    if first["type"] == UNKNOWN:
        *above, key = map(str, first["loc"])
        for part in above:
            kind = get_type_hints(kind)[part]
        check_choice(key, [field.name for field in fields(kind)], ".".join([*filter(None, [where]), *above]))
    name = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in first["loc"]).lstrip(".")
    wrong = "is missing" if first["type"] == "missing" else f"{first['msg']}, found {first['input']!r:.80}"
    raise SceneError(": ".join(filter(None, [where, name, wrong.replace("Input should", "must")])))


@cache
def _adapter(kind: Any) -> Any:
    from pydantic import TypeAdapter

    return TypeAdapter(kind)


def check_choice(name: str, known: Collection[str], where: str, noun: str = "") -> None:
    """Raise `SceneError` unless a name is one of those that are known; ``noun`` is what they are the names of."""
    if name not in known:
        near = difflib.get_close_matches(name, known, n=1)
        what, more = f"{noun} '{name}'".lstrip(), ", ..." if len(known) > MOST_NAMED else ""
        hint = f"did you mean '{near[0]}'?" if near else f"choose from {', '.join([*known][:MOST_NAMED])}{more}"
        raise SceneError(f"{where}: there is no {what}; {hint}".removeprefix(": "))


def inside(folder: Path, name: object, where: str) -> Path:
    """Return the path of a file that a table or a tour names; it lies in the folder, symbolic links followed.

    The file need not exist. ``where`` it is named is for errors.

    Raises:
        SceneError: the name is none, or leads out of the folder.
    """
    if not isinstance(name, str) or not name.strip(" ./\\") or not name.isprintable() or len(name) > LONGEST:
        raise SceneError(f"{where}: expected the name of a file, found {str(name)[:50]!r}")
    text = name.replace("\\", "/")
    if "://" in text or text.startswith("//"):
        raise SceneError(f"{where}: '{name[:100]}' is on the web; nothing is downloaded, fetch the files first")
    path = PurePosixPath(text)
    if path.is_absolute() or ".." in path.parts or ":" in path.parts[0]:
        raise SceneError(f"{where}: '{name[:100]}' lies outside of {folder}")
    file = folder / path
    real, root = os.path.realpath(file), os.path.realpath(folder)
    if os.path.commonpath([real, root]) != root:
        raise SceneError(f"{where}: '{name[:100]}' is a link that leads out of {folder}; put the file itself there")
    return file


def text_of(file: Path, most: int) -> str:
    """Return the text of a file that somebody else wrote, UTF-8; `SceneError` if it cannot be read, or is none."""
    try:
        return read_text(file, most, encoding="utf-8-sig")
    except OSError as error:
        raise SceneError(f"{file}: cannot be read ({error.strerror})") from None
    except ValueError as error:
        raise SceneError(str(error)) from None


def read_csv(
    file: Path, required: Sequence[str], optional: Sequence[str] = (), most: int = MOST
) -> list[tuple[str, dict[str, str]]]:
    """Return the rows of a CSV file by column, each with the file and line for errors; empty lines are left out.

    `SceneError` if it cannot be read, has another column or lacks one, or a line is none of the table.
    """
    lines = text_of(file, most).splitlines()
    if not lines:
        raise SceneError(f"{file}: is empty; its first line names the columns: {','.join(required)}")
    # Spreadsheets of countries with a decimal comma separate by semicolons.
    semicolons = ";" in lines[0] and "," not in lines[0]
    reader = csv.reader(lines, delimiter=";" if semicolons else ",")
    rows = []
    try:
        columns = [column.strip() for column in next(reader)]
        for column in columns:
            check_choice(column, [*required, *optional], f"{file}: line 1: columns")
            if columns.count(column) > 1:
                raise SceneError(f"{file}: line 1: the column '{column}' is named twice")
        if missing := [column for column in required if column not in columns]:
            raise SceneError(f"{file}: line 1: the column '{missing[0]}' is missing; found {', '.join(columns)}")
        for line in reader:
            cells = [cell.strip() for cell in line]
            if semicolons:
                cells = [cell.replace(",", ".") if DECIMAL_COMMA.fullmatch(cell) else cell for cell in cells]
            where = f"{file}: line {reader.line_num}"
            if any(cells) and len(cells) != len(columns):
                raise SceneError(f"{where}: {len(cells)} cells for {len(columns)} columns")
            if any(cells):
                rows.append((where, dict(zip(columns, cells, strict=True))))
    except csv.Error as error:
        raise SceneError(f"{file}: line {reader.line_num}: is no line of a table ({error})") from None
    return rows


PREFIX = ".unfinished-"
"""What the names of temporary files begin with; only a killed process leaves one."""


@contextmanager
def atomic_path(file: str | Path) -> Iterator[Path]:
    """Write a file under a temporary name within this context, and rename it at the end.

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
    finite = json.loads(json.dumps(data), parse_constant=lambda _: None)
    write_text(file, json.dumps(finite, indent=1, allow_nan=False) + "\n")


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a file's bytes, as hexadecimal digits."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
