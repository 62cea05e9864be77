"""The options of every recipe and command but ``train``: what its file in ``conf/`` lists, with types by name."""

import re
from dataclasses import field, make_dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import yaml  # PyYAML comes with OmegaConf
from omegaconf import MISSING

from dirl.config.bounds import Bounds
from dirl.config.meanings import entries
from dirl.config.places import CONF, RECIPES
from dirl.config.schemas import (
    Correlation,
    Device,
    Episodes,
    ExperimentName,
    Frames,
    GoalView,
    HeldOut,
    Match,
    NotNegative,
    Positive,
    Precision,
    Seed,
    Split,
    Starts,
    Stop,
    TrainConfig,
)

Layout = StrEnum("Layout", ["icra17"])

Pixels = Annotated[int, Bounds(16, 4096)]

TYPES: dict[str, Any] = {
    "agents": list[str],
    "axes": list[str],
    "collections": list[str],
    "count": Positive,
    "device": Device,
    "encoder": str | None,
    "episodes_per_goal": Episodes,
    "evaluate.goals": Any,
    "evaluate.map": Annotated[float, Bounds(0, 100)],
    "evaluate.scene": Any,
    "every": Positive,
    "experiment": ExperimentName,
    "exposure": NotNegative,
    "field_of_view": Annotated[float, Bounds(10, 150)],
    "frames_per_scene": Frames,
    "goal": Annotated[int, Bounds(0)],
    "goal_view": GoalView,
    "goals": list[int],
    "heading": NotNegative,
    "headings": Annotated[int, Bounds(4, 36)],
    "height": Pixels,
    "last_steps": Annotated[int, Bounds(0, 10**6)],
    "layout": Layout,
    "match": Match,
    "max_steps": Episodes,
    "pitch": Annotated[float, Bounds(-80, 80)],
    "places": Annotated[int, Bounds(2)],
    "position": NotNegative,
    "precision": Precision,
    "reach": Annotated[float, Bounds(0.1, 100)],
    "repeats": Positive,
    "report.encoder": str,
    "report.workers": Positive,
    "rooms": Positive,
    "seed": Seed,
    "skip": list[str],
    "slip": HeldOut,
    "split": Split,
    "evaluate.starts": Starts,
    "step": Annotated[float, Bounds(0.05, 10)],
    "stop": Stop,
    "threshold": Correlation,
    "tolerance": Annotated[float, Bounds(0, 180)],
    "train": list[str],
    "trials": Positive,
    "trust": list[str],
    "turn": Annotated[float, Bounds(1, 360)],
    "turn_error": Annotated[float, Bounds(0, 90)],
    "width": Pixels,
    "workers": int,
    "worlds": list[Any],
    "yaws": list[float],
}
"""Of options by name, or by that of the recipe too; any other is of the type of its value in ``conf/``, or a text."""


def _schema(file: Path) -> type:
    """The dataclass of the options in a file; those without a value there, ``???``, must be given."""
    options: dict[str, list[Any]] = {"": []}
    for name, (text, _) in entries(file).items():
        group, _, last = name.rpartition(".")
        if not group.startswith("hydra"):
            value = None if text == MISSING else yaml.safe_load(text)
            own = TYPES.get(last, str if value is None else type(value))
            kind = TYPES.get(f"{file.stem}.{name}", own)
            if text == "null" and kind is not Any:
                kind |= None
            options.setdefault(group, []).append((last, kind, field(default=MISSING)))
    inside = {group: make_dataclass(group, found) for group, found in options.items() if group}
    groups = [(group, made, field(default_factory=made)) for group, made in inside.items()]
    return make_dataclass(file.stem, options[""] + groups)


def _files(recipe: str) -> list[Path]:
    """The file of a recipe's options, or those of its commands."""
    return sorted((CONF / recipe).glob("*.yaml")) or [CONF / f"{recipe}.yaml"]


SCHEMAS = {
    "train": TrainConfig,
    **{file.stem: _schema(file) for recipe in RECIPES if recipe != "train" for file in _files(recipe)},
}
"""What each recipe, or command of ``recipes/scenes.py``, takes; its file in ``conf/`` names it ``<key>_schema``."""


def command_meanings() -> dict[str, str]:
    """What each command of ``recipes/scenes.py`` does: the beginning of its help."""
    headers = {file.stem: entries(file)["hydra.help.header"][0] for file in _files("scenes")}
    return {name: re.split(r"[:.,;]", header.strip("'\""))[0] for name, header in headers.items()}
