"""What options mean: the comments beside their values in conf/."""

import re
from collections.abc import Iterable
from pathlib import Path

from dirl.config.places import CONF, RECIPES

LINE = re.compile(r"( *)([A-Za-z_0-9]+):\s*([^#]*?)\s*(?:#\s*(.*))?$")
"""Of YAML: indent, name, value, comment."""


def entries(file: Path) -> dict[str, tuple[str, str]]:
    """Value and comment of each option that a YAML file sets, by dotted name."""
    text, group = file.read_text(encoding="utf-8"), file.parent.name
    of_group = file.parent != CONF and group not in RECIPES and "@package _global_" not in text
    found: dict[str, tuple[str, str]] = {}
    for indent, name, value, comment in _named(text, f"{group}." if of_group else ""):
        if value or indent:
            found[name] = (value, comment)
    for name in [name.removesuffix(".start") for name in found if name.endswith(".start")]:
        ends = f"{{start:{found[f'{name}.start'][0]},end:{found[f'{name}.end'][0]}}}"
        found[name] = (ends, found[name][1])
    return found


def explained(values: str, files: Iterable[Path]) -> str:
    """A configuration in YAML with what each option means beside it, from the files that it is composed of.

    Where several files say what an option means, the last one counts.
    """
    meanings = {name: comment for file in files for name, (_, comment) in entries(file).items() if comment}
    names = (name for _, name, _, _ in _named(values, ""))
    lines = []
    for line in values.splitlines():
        meaning = meanings.get(next(names)) if LINE.match(line) else None
        lines.append(f"{line:<36}  # {meaning}\n" if meaning else f"{line}\n")
    return "".join(lines)


def _named(text: str, prefix: str) -> Iterable[tuple[int, str, str, str]]:
    """Indent, dotted name, value and comment of each line of YAML that has a name."""
    above: list[tuple[int, str]] = []  # indents and names of what this line is in
    for line in text.splitlines():
        match = LINE.match(line)
        if match is None:
            continue
        indent, name, value, comment = match.groups()
        above = [(deep, group) for deep, group in above if deep < len(indent)]
        yield len(indent), prefix + ".".join([*(group for _, group in above), name]), value, comment or ""
        if not value:
            above.append((len(indent), name))
