"""Tables that somebody else may have written, as CSV."""

import csv
import re
from collections.abc import Sequence
from pathlib import Path

from dirl.scenes.io.bounded import MOST, read_text
from dirl.scenes.io.checked import check_choice
from dirl.scenes.scene import SceneError

DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+")


def read_rows(file: Path) -> list[dict[str, str]]:
    """Return the rows of a CSV file whose first line names the columns; ValueError if it is no such table."""
    try:
        return list(csv.DictReader(read_text(file).splitlines(), strict=True))
    except csv.Error as error:
        raise ValueError(f"{file}: is no table ({error})") from None


def read_csv(
    file: Path, required: Sequence[str], optional: Sequence[str] = (), most: int = MOST
) -> list[tuple[str, dict[str, str]]]:
    """Return the rows of a CSV file by column, each with the file and line for errors; empty lines are left out.

    `SceneError` if it cannot be read, has another column or lacks one, or a line is none of the table.
    """
    try:
        lines = read_text(file, most, encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise SceneError(f"{file}: cannot be read ({error.strerror})") from None
    except ValueError as error:
        raise SceneError(f"{error}; save it as CSV UTF-8") from None
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
