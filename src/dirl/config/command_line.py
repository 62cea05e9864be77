"""The manners of the recipes on the command line: names for Hydra, and errors of one line."""

import difflib
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, get_args, get_origin

from hydra.core.config_store import ConfigStore
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import ChoiceSweep, Override, QuotedString, Sweep
from hydra.errors import OverrideParseException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from dirl.config.scene_schemas import (
    BuildConfig,
    EncodeConfig,
    ExportConfig,
    ImportConfig,
    InspectConfig,
    PhotosConfig,
    SampleConfig,
    ThorConfig,
)
from dirl.config.schemas import BenchmarkConfig, ConfigError, EvaluateConfig, ReportConfig, TrainConfig

SCHEMAS = {
    "train": TrainConfig,
    "evaluate": EvaluateConfig,
    "report": ReportConfig,
    "benchmark": BenchmarkConfig,
    "thor": ThorConfig,
    "photos": PhotosConfig,
    "build": BuildConfig,
    "sample": SampleConfig,
    "encode": EncodeConfig,
    "export": ExportConfig,
    "import": ImportConfig,
    "inspect": InspectConfig,
}
"""What each recipe, or command of ``recipes/scenes.py``, takes; its file in ``conf/`` names it ``<key>_schema``."""


def register() -> None:
    """Give Hydra the types, and the resolver that names a run's folder."""
    store = ConfigStore.instance()
    for name, schema in SCHEMAS.items():
        store.store(f"{name}_schema", schema)
    OmegaConf.register_new_resolver("run_folder", _run_folder, replace=True)


def _run_folder(resume: str | None, system: str, scene: Any, time: str) -> str:
    """The folder to resume, or ``runs/dirl_bathroom_02/<time>`` (several scenes joined by +, the stems of files)."""
    scenes = [scene] if isinstance(scene, str) else list(scene or ["nowhere"])
    return resume or f"runs/{system}_{'+'.join(Path(name).stem for name in scenes)}/{time}"


def option_types(schema: type, prefix: str = "") -> dict[str, Any]:
    """The types of all options of a configuration, by their dotted names."""
    types: dict[str, Any] = {}
    for option in fields(schema):
        kind = option.default_factory if callable(option.default_factory) else option.type
        types[prefix + option.name] = kind
        if is_dataclass(kind):
            types |= option_types(kind, f"{prefix}{option.name}.")  # type: ignore[arg-type]
    return types


def choose_command(commands: Mapping[str, str], arguments: Sequence[str], text: str) -> tuple[str, list[str]]:
    """The command that a command line begins with, and what follows it.

    Args:
        commands: what each one does, by name.
        arguments: the command line after the program.
        text: printed above the list of commands where ``--help`` stands in place of a command, or nothing.

    Raises:
        ConfigError: there is no such command.
        SystemExit: help was asked for.
    """
    if not arguments or arguments[0] in ("--help", "-h"):
        lines = [f"  {name:<8} {meaning}" for name, meaning in commands.items()]
        print("\n".join([text.strip(), "", *lines, "", "<command> --help tells the options of one."]))
        raise SystemExit(0)
    name, *rest = arguments
    if name not in commands:
        near = difflib.get_close_matches(name, commands, n=1)
        hint = f"did you mean {near[0]}?" if near else f"choose from {', '.join(commands)}"
        raise ConfigError(f"there is no command '{name}'; {hint}")
    return name, rest


def check_overrides(schema: type, arguments: Sequence[str], groups: Sequence[str] = ()) -> None:
    """Check a command line's ``name=value`` arguments; Hydra's own messages take many lines and list no choices.

    Args:
        schema: what the recipe takes.
        arguments: the command line after the program.
        groups: folders of ``conf/`` that can be chosen from besides.

    Raises:
        ConfigError: there is no such option, or its value is of another type.
    """
    known = option_types(schema) | dict.fromkeys(groups, schema)
    given = [text for text in arguments if "=" in text and not text.startswith("-")]
    try:
        overrides = OverridesParser.create().parse_overrides(given)
    except OverrideParseException:
        return  # Hydra says what is wrong with the form
    for override in overrides:
        name = override.key_or_group
        if name.split("/")[0].split(".")[0] == "hydra":
            continue
        if name in known:
            _check_value(schema, name, known[name], override)
            continue
        level, _, last = name.rpartition(".")
        inside = {
            known_name.split(".")[-1]: known_name for known_name in known if known_name.rpartition(".")[0] == level
        }
        near = [known_name for known_name in known if known_name.split(".")[-1] == last]
        near = near or [inside[match] for match in difflib.get_close_matches(last, inside, n=3)]
        choices = ", ".join(inside.values() or (option for option in known if "." not in option))
        hint = f"did you mean {' or '.join(near)}?" if near else f"choose from {choices}"
        raise ConfigError(f"there is no option '{name}'; {hint}")


def _check_value(schema: type, name: str, kind: Any, override: Override) -> None:
    """Raise `ConfigError` unless OmegaConf can make the value, or each of a sweep's list, what the option wants."""
    if is_dataclass(kind) or override.is_delete():  # a choice of Hydra's config groups
        return
    value = override.value()
    for one in value.list if isinstance(value, ChoiceSweep) else [] if isinstance(value, Sweep) else [value]:
        given = one.text if isinstance(one, QuotedString) else one
        try:
            OmegaConf.update(OmegaConf.structured(schema), name, given)
        except OmegaConfBaseException:
            shown = "null" if given is None else given
            raise ConfigError(f"{name}={shown}: must be {_wanted(kind)}") from None


def _wanted(kind: Any) -> str:
    """A type in words."""
    if get_origin(kind) is UnionType:
        return " or ".join(map(_wanted, get_args(kind)))
    if get_origin(kind) is list:
        (each,) = get_args(kind)
        return "a list" if each is Any else f"a list, each {_wanted(each)}"
    if issubclass(kind, Enum):
        return f"one of {', '.join(kind)}"
    return {int: "a whole number", float: "a number", bool: "true or false", str: "text", NoneType: "null"}[kind]


@contextmanager
def job_errors(folder: Path) -> Iterator[None]:
    """Within this context an error of one job of a sweep is told at once, under its folder's name; Hydra keeps it.

    Hydra goes on with the other jobs, and only at the end says what went wrong in the first that failed.
    """
    try:
        yield
    except Exception as error:
        print(f"failed: {folder}: {error}", file=sys.stderr, flush=True)
        raise


@contextmanager
def one_line_errors(folder: Path | None = None) -> Iterator[None]:
    """Within this context an error in what the user gave ends the program with its message, without a traceback.

    Args:
        folder: made by Hydra beforehand; deleted again if nothing has been written there.
    """
    try:
        yield
    except ValueError as error:
        if folder is not None:
            with suppress(OSError):
                os.removedirs(folder)
        raise SystemExit(f"error: {error}") from None
