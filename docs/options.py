"""The page of all options, from the types in src/dirl/config.py and the values and comments in conf/."""

import re
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from dirl.config import BenchmarkConfig, EvaluateConfig, TrainConfig

GROUPS = {"preset", "system", "objective", "source", "logger"}


def entries(file: Path) -> dict[str, tuple[str, str]]:
    """Value and comment of each option that a YAML file sets, by dotted name."""
    text = file.read_text()
    inside = file.parent.name in GROUPS and "@package _global_" not in text
    level, found = (f"{file.parent.name}." if inside else ""), {}
    prefix = level
    for line in text.splitlines():
        match = re.match(r"( *)([a-z_]+):\s*([^#]*?)\s*(?:#\s*(.*))?$", line)
        if match is None:
            continue
        indent, name, value, comment = match.groups()
        if not indent:
            prefix = level
        if not value and not indent:
            prefix = f"{name}."
        else:
            found[prefix + name] = (value, comment or "")
    return found


def options(schema: type, prefix: str = "") -> dict[str, str]:
    """The type of each option of a schema, by dotted name."""
    found: dict[str, str] = {}
    for option in fields(schema):
        kind: Any = option.default_factory if callable(option.default_factory) else option.type
        if is_dataclass(kind):
            found |= options(kind, f"{prefix}{option.name}.")  # type: ignore[arg-type]
        elif isinstance(kind, type):
            found[prefix + option.name] = " / ".join(kind) if hasattr(kind, "__members__") else kind.__name__
        else:
            found[prefix + option.name] = str(kind).replace("dirl.config.", "").replace("typing.", "")
    return found


def table(schema: type, columns: dict[str, list[Path]]) -> list[str]:
    """A Markdown table, a row an option; each column of values is read from its files, later ones winning."""
    read = {name: {k: v for file in files for k, v in entries(file).items()} for name, files in columns.items()}
    lines = ["| option | type | " + " | ".join(columns) + " | meaning |", "|---|---|" + "---|" * (len(columns) + 1)]
    for name, kind in options(schema).items():
        here = [of_column.get(name, ("", "")) for of_column in read.values()]
        meaning = next((comment for _, comment in here if comment), "")
        cells = [f"`{name}`", kind, *(f"`{value}`" if value else "" for value, _ in here), meaning]
        lines.append("| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |")
    return lines


def write_page(conf: Path, page: Path) -> None:
    """Write the page, if it would change."""
    common = [conf / "train.yaml", *(conf / f"{n}.yaml" for n in ("source/rooms", "objective/a2c", "logger/csv"))]
    common.append(conf / "system" / "dirl.yaml")
    presets = {name: [*common, conf / "preset" / f"{name}.yaml"] for name in ("fast", "paper")}
    lines = ["# Every option", "", "Written by `docs/options.py` when the site is built; do not edit.", ""]
    lines += ["## recipes/train.py", "", *table(TrainConfig, presets), ""]
    for name, schema in (("evaluate", EvaluateConfig), ("benchmark", BenchmarkConfig)):
        lines += [f"## recipes/{name}.py", "", *table(schema, {"value": [conf / f"{name}.yaml"]}), ""]
    text = "\n".join(lines)
    if not page.exists() or page.read_text() != text:
        page.write_text(text)
