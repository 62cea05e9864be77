"""The options of the commands of ``recipes/scenes.py``: what ``conf/scenes/`` lists, with types and bounds by name."""

import re
from dataclasses import field, make_dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import yaml  # PyYAML comes with OmegaConf
from omegaconf import MISSING

from dirl.config.bounds import Bounds
from dirl.config.meanings import entries
from dirl.config.places import CONF
from dirl.config.schemas import Correlation, Device, Match, NotNegative, Positive, Precision, Seed

Layout = StrEnum("Layout", ["icra17"])

Pixels = Annotated[int, Bounds(16, 4096)]

TYPES: dict[str, Any] = {
    "axes": list[str],
    "count": Positive,
    "device": Device,
    "encoder": str | None,
    "exposure": NotNegative,
    "field_of_view": Annotated[float, Bounds(10, 150)],
    "goals": list[int],
    "heading": NotNegative,
    "headings": Annotated[int, Bounds(4, 36)],
    "height": Pixels,
    "layout": Layout,
    "match": Match,
    "pitch": Annotated[float, Bounds(-80, 80)],
    "places": Annotated[int, Bounds(2)],
    "position": NotNegative,
    "precision": Precision,
    "reach": Annotated[float, Bounds(0.1, 100)],
    "seed": Seed,
    "skip": list[str],
    "step": Annotated[float, Bounds(0.05, 10)],
    "threshold": Correlation,
    "tolerance": Annotated[float, Bounds(0, 180)],
    "turn": Annotated[float, Bounds(1, 360)],
    "width": Pixels,
    "workers": int,
    "yaws": list[float],
}
"""Of options by name; an option that is not here is of the type of its value in ``conf/``, or a text."""


def _schema(file: Path) -> type:
    """The dataclass of a command's options; those without a value there, ``???``, must be given."""
    options: dict[str, list[Any]] = {"": []}
    for name, (text, _) in entries(file).items():
        group, _, last = name.rpartition(".")
        if not group.startswith("hydra"):
            value = None if text == MISSING else yaml.safe_load(text)
            kind = TYPES.get(last, str if value is None else type(value))
            options.setdefault(group, []).append(
                (last, kind | None if text == "null" else kind, field(default=MISSING))
            )
    inside = {group: make_dataclass(group, found) for group, found in options.items() if group}
    groups = [(group, made, field(default_factory=made)) for group, made in inside.items()]
    return make_dataclass(file.stem, options[""] + groups)


COMMANDS = {file.stem: _schema(file) for file in sorted((CONF / "scenes").glob("*.yaml"))}
"""The options of each command."""


def command_meanings() -> dict[str, str]:
    """What each command does: the beginning of its help."""
    headers = {name: entries(CONF / "scenes" / f"{name}.yaml")["hydra.help.header"][0] for name in COMMANDS}
    return {name: re.split(r"[:.,;]", header.strip("'\""))[0] for name, header in headers.items()}
