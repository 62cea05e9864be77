"""The page of all options, from the types in `dirl.config` and the values and comments in conf/."""

import re
from dataclasses import fields, is_dataclass
from enum import EnumMeta
from pathlib import Path
from typing import Any, get_args

from dirl.config.command_line import SCHEMAS
from dirl.config.schemas import TrainConfig

CHOICES = ("system", "preset", "objective", "source", "logger")
"""The folders of conf/ that hold files to choose from."""

DEFAULTS = ("source/rooms", "objective/a2c", "system/dirl", "logger/csv")
"""Chosen where nothing is said, besides preset/fast, which has a word of its own in the table."""

WORDS = {str: "text", int: "integer", float: "number", bool: "true / false", Any: "text or list", type(None): "null"}

ROWS = "```{rst-class} rows\n```\n"
"""Before a table: narrow screens show it as a list, see _static/site.css."""

INTRODUCTION = """\
An option is given as `name=value` behind the recipe: `python recipes/train.py scene=all network.width=256`. Where a
value follows the word *fast* or *paper*, the preset of that name sets it (`preset=paper`; `fast` is the default); both
can be overridden one by one. This page is written by `docs/options.py` from the types in `src/dirl` and the values in
`conf/` when the site is built.
"""


def entries(file: Path) -> dict[str, tuple[str, str]]:
    """Value and comment of each option that a YAML file sets, by dotted name."""
    text = file.read_text()
    inside = file.parent.name in CHOICES and "@package _global_" not in text
    level, found = (f"{file.parent.name}." if inside else ""), {}
    prefix = level
    for line in text.splitlines():
        match = re.match(r"( *)([a-z_0-9]+):\s*([^#]*?)\s*(?:#\s*(.*))?$", line)
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


def words(kind: Any) -> str:
    """The type of an option for people."""
    if isinstance(kind, EnumMeta):
        return " / ".join(kind)
    if kind in WORDS:
        return WORDS[kind]
    inside = get_args(kind)
    return " or ".join(map(words, inside)) if type(None) in inside else "list"


def groups(schema: type) -> dict[str, tuple[str, dict[str, str]]]:
    """What each group of a schema is, and the types of its options by dotted name; "" holds those of no group."""
    found: dict[str, tuple[str, dict[str, str]]] = {"": ("", {})}
    for option in fields(schema):
        kind: Any = option.default_factory
        if is_dataclass(kind):
            inside = {f"{option.name}.{field.name}": words(field.type) for field in fields(kind)}
            found[option.name] = ((kind.__doc__ or "").rstrip("."), inside)
        else:
            found[""][1][option.name] = words(option.type)
    return found


def table(options: dict[str, str], files: dict[str, list[Path]]) -> list[str]:
    """A Markdown table, a row an option; ``files`` set values, under a word to tell them by ("" for plain ones)."""
    read = {word: {k: v for file in of_word for k, v in entries(file).items()} for word, of_word in files.items()}
    lines = [ROWS, "| option | value | meaning |", "|---|---|---|"]
    for name, kind in options.items():
        here = {word: of_word[name] for word, of_word in read.items() if name in of_word}
        values = [f"{word} `{value}`".strip() for word, (value, _) in here.items()]
        meaning = next((comment for _, comment in here.values() if comment), "")
        told = all(choice in meaning for choice in kind.split(" / "))  # a comment that lists the choices says it all
        cells = [f"`{name}`" if told else f"`{name}` <small>{kind}</small>", "<br>".join(values), meaning]
        lines.append("| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |")
    return [*lines, ""]


def choices(conf: Path) -> list[str]:
    """A Markdown table of the files to choose from, but for the presets, and what each sets."""
    lines = [ROWS, "| choice | sets |", "|---|---|"]
    for group in CHOICES:
        for file in sorted((conf / group).glob("*.yaml")):
            if group != "preset":
                values = [f"`{name}={value}`" for name, (value, _) in entries(file).items()]
                lines.append(f"| `{group}={file.stem}` | {', '.join(values)} |")
    return [*lines, ""]


def recipe_table(file: Path) -> list[str]:
    """The table of options that are all in one file."""
    return table(groups(SCHEMAS[file.stem])[""][1], {"": [file]})


def write_page(conf: Path, page: Path) -> None:
    """Write the page, if it would change."""
    common = [conf / "train.yaml", *(conf / f"{name}.yaml" for name in DEFAULTS)]
    files = {"": common, "fast": [conf / "preset/fast.yaml"], "paper": [conf / "preset/paper.yaml"]}
    lines = ["# Every option", "", INTRODUCTION, "## recipes/train.py", ""]
    for group, (meaning, options) in groups(TrainConfig).items():
        if group:
            meaning = meaning[0].lower() + meaning[1:]
            lines += [f"### {group}" if meaning == f"the {group}" else f"### {group}: {meaning}", ""]
        lines += table(options, files)
    lines += ["### What a choice sets", "", *choices(conf)]
    for name in ("evaluate", "benchmark"):
        lines += [f"## recipes/{name}.py", "", *recipe_table(conf / f"{name}.yaml")]
    lines += ["## recipes/scenes.py", ""]
    for file in sorted((conf / "scenes").glob("*.yaml")):
        lines += [f"### {file.stem}", "", *recipe_table(file)]
    text = "\n".join(lines)
    if not page.exists() or page.read_text() != text:
        page.write_text(text)
