"""What somebody else wrote, checked: values against annotated types, names of files, tables; errors are one line."""

import csv
import difflib
import os
import re
from collections.abc import Collection, Sequence
from dataclasses import fields
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Any, get_type_hints

from dirl.scenes.io.bounded import MOST, read_text
from dirl.scenes.scene import SceneError

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
        found = error.errors(include_url=False)
    first = next((one for one in found if one["type"] == UNKNOWN), found[0])
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

    The file need not exist.

    Args:
        folder: of the table or the tour.
        name: of the file, relative to the folder.
        where: it is named, for errors.

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
    found = folder / path
    real, root = os.path.realpath(found), os.path.realpath(folder)
    if os.path.commonpath([real, root]) != root:
        raise SceneError(f"{where}: '{name[:100]}' is a link that leads out of {folder}; put the file itself there")
    return found


def text_of(file: Path, most: int = MOST) -> str:
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
        _check_columns(columns, required, optional, file)
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


def _check_columns(columns: Sequence[str], required: Sequence[str], optional: Sequence[str], file: Path) -> None:
    known = [*required, *optional]
    for column in columns:
        check_choice(column, known, f"{file}: line 1: columns")
        if columns.count(column) > 1:
            raise SceneError(f"{file}: line 1: the column '{column}' is named twice")
    missing = [column for column in required if column not in columns]
    if missing:
        raise SceneError(f"{file}: line 1: the column '{missing[0]}' is missing; found {', '.join(columns)}")
