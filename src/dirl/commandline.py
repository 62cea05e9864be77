"""The manners of the recipes on the command line: names for Hydra, and errors of one line."""

import difflib
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from hydra.core.config_store import ConfigStore
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import OverrideParseException
from omegaconf import OmegaConf

from dirl.config import BenchmarkConfig, ConfigError, EvaluateConfig, TrainConfig


def register() -> None:
    """Give Hydra the types, and the resolver that names a run's folder."""
    store = ConfigStore.instance()
    store.store("train_schema", TrainConfig)
    store.store("evaluate_schema", EvaluateConfig)
    store.store("benchmark_schema", BenchmarkConfig)
    OmegaConf.register_new_resolver("run_folder", _run_folder, replace=True)


def _run_folder(resume: str | None, system: str, scene: Any, time: str) -> str:
    """The folder to resume, or ``runs/dirl_bathroom_02/<time>`` (several scenes joined by +, the stems of files)."""
    scenes = [scene] if isinstance(scene, str) else list(scene or ["nowhere"])
    return resume or f"runs/{system}_{'+'.join(Path(name).stem for name in scenes)}/{time}"


def option_names(schema: type, prefix: str = "") -> list[str]:
    """The dotted names of all options of a configuration."""
    names = []
    for option in fields(schema):
        names.append(prefix + option.name)
        kind = option.default_factory if callable(option.default_factory) else option.type
        if is_dataclass(kind):
            names += option_names(kind, f"{prefix}{option.name}.")  # type: ignore[arg-type]
    return names


def check_overrides(schema: type, arguments: Sequence[str]) -> None:
    """Check the names of a command line's ``name=value`` arguments; Hydra's own message does not list the choices.

    Raises:
        ConfigError: there is no such option.
    """
    known = option_names(schema)
    given = [text for text in arguments if "=" in text and not text.startswith("-")]
    try:
        overrides = OverridesParser.create().parse_overrides(given)
    except OverrideParseException:
        return  # Hydra says what is wrong with the form
    for override in overrides:
        name = override.key_or_group
        if name in known or name.split("/")[0].split(".")[0] == "hydra":
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
