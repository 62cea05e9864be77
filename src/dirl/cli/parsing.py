"""Command lines of ``name=value``, read by Hydra's grammar; errors of Hydra and OmegaConf in one line."""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import is_dataclass
from pathlib import Path
from typing import NoReturn, TypeVar

from hydra import compose, initialize_config_dir
from hydra._internal.utils import get_args_parser
from hydra.core.config_store import ConfigStore
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import ChoiceSweep, Override, QuotedString
from hydra.errors import HydraException
from omegaconf import DictConfig, ListConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from dirl.config.components import GROUPS, check_choice
from dirl.config.files import typed
from dirl.config.folders import CONF
from dirl.config.schemas import ConfigError, Schedule, TrainConfig, Weight, meanings, option_types

T = TypeVar("T")

EXTRAS = {"joblib": "sweeps", "optuna": "optuna", "ray": "ray", "submitit_local": "slurm", "submitit_slurm": "slurm"}
"""Of dirl, by the launcher or sweeper of Hydra that they bring."""


def _run_folder(resume: str | None, out: str | None, system: str, scene: object, time: str) -> str:
    """Return the folder given, or ``runs/dirl_bathroom_02/<time>`` (several scenes joined by +, files by stems)."""
    scenes = list(map(str, scene)) if isinstance(scene, ListConfig) else [str(scene or "nowhere")]
    return resume or out or f"runs/{system}_{'+'.join(Path(name).stem for name in scenes)}/{time}"


# What Hydra composes a training with: the types of its options, and the names of the folders of runs and sweeps.
ConfigStore.instance().store("train_schema", TrainConfig)
OmegaConf.register_new_resolver("run_folder", _run_folder, replace=True)
OmegaConf.register_new_resolver("sweep_folder", lambda out, time: out or f"multirun/{time}", replace=True)


@contextmanager
def one_line_errors() -> Iterator[None]:
    """Turn an error of Hydra or OmegaConf within this context into a `ConfigError` of one line: its text and cause.

    Where they looked, and where to read on, is left out.
    """
    try:
        yield
    except (HydraException, OmegaConfBaseException) as error:
        said = [str(each) for each in (error, error.__cause__) if each is not None]
        ends = r"\n\s*(?:full_key|object_type|Config search path|See https|Set the env)|\s*\nDid you mean"
        text = ": ".join(" ".join(re.split(ends, part)[0].split()) for part in said).removeprefix(
            "Error merging override "
        )
        for plugin in set(re.findall(r"'hydra/(?:launcher|sweeper)/(\w+)'", text)) & set(EXTRAS):
            text = f"Hydra's {plugin} is not installed: pip install 'dirl[{EXTRAS[plugin]}]'"
        raise ConfigError(text) from None


def parse(schema: type[T], arguments: Sequence[str]) -> T:
    """Return the dataclass of a recipe's options, or of a command's of ``recipes/scenes.py``.

    Raises:
        ConfigError: there is no such option, its value is of another type or out of bounds, or one is missing.
    """
    with one_line_errors():
        config = OmegaConf.structured(schema)
        known = option_types(schema)
        for text in arguments:
            override = parsed(text)
            name = override.key_or_group
            check_choice(f"option '{name}'", name, known)
            if override.is_delete() or override.is_sweep_override():
                raise ConfigError(f"{text}: must be one value; a list is written as '{name}=[a,b]'")
            if is_dataclass(known[name]):
                raise ConfigError(f"{text}: {name} is a group of options; choose one of it, {name}.<option>=...")
            try:
                OmegaConf.update(config, name, override.value())
            except OmegaConfBaseException as error:
                raise ConfigError(f"{text}: {str(error).splitlines()[0]}") from None
        for name in map(str, config):
            if OmegaConf.is_missing(config, name):
                raise ConfigError(f"{name} must be given: {meanings(schema)[name]}")
        options: T = typed(config)
        return options


def parsed(text: str) -> Override:
    """Return an argument ``name=value`` as Hydra understands it; `ConfigError` if it has another form."""
    if not re.match(r"~|[^=]+=", text):
        raise ConfigError(f"{text or 'an empty text'}: is not of the form name=value")
    try:
        return OverridesParser.create().parse_override(text)
    except HydraException as error:
        place = str(error).splitlines()[0].partition(" expecting ")[0]
        raise ConfigError(
            f"{text}: is not of the form name=value ({place}); quote a text with such signs: 'name=\"...\"'"
        ) from None


def check_flags(arguments: Sequence[str]) -> None:
    """Raise `ConfigError` unless Hydra knows all flags of a training; itself it would print several lines."""

    def refuse(message: str) -> NoReturn:
        raise ConfigError(f"{message}; flags come before options: --hydra-help tells them")

    parser = get_args_parser()
    parser.error = refuse  # type: ignore[method-assign]
    if parser.parse_args(list(arguments)).experimental_rerun is not None:
        refuse("--experimental-rerun: a run goes on by resume=<its folder>")


def prepare(arguments: Sequence[str]) -> list[str]:
    """Return the arguments of a training as Hydra takes them.

    Options of components get the ``++`` by which Hydra takes what the class has and its YAML does not list; they are
    checked against the constructor of the class (`dirl.config.components`). A number given for a schedule is constant.

    Raises:
        ConfigError: an argument has another form, or there is no such option.
    """
    known = option_types(TrainConfig)
    prepared, skip = [], False
    for text in arguments:
        if skip or text.startswith("-"):  # flags, and the folder that follows one
            prepared.append(text)
            skip = text in ("--config-dir", "-cd", "--config-name", "-cn", "--config-path", "-cp", "--cfg", "-c")
            continue
        override = parsed(text)
        name = override.key_or_group
        group = re.split(r"[/.]", name)[0]
        if group == "hydra" or "@" in text.partition("=")[0] or (CONF / name).is_dir():
            several = name == "losses"  # the one group of which a list may be chosen
            if group != "hydra" and any(isinstance(v, dict if several else dict | list) for v in _values(override)):
                raise ConfigError(f"{text}: must name a choice of {name}: --help lists them")
            prepared.append(text)
        elif "." in name and group in GROUPS:
            prepared.append(text if text.startswith(("+", "~")) else f"++{text}")
        else:
            check_choice(f"option '{name}'", name, known)
            prepared.append(_constant(name, override) if known[name] in (Schedule, Weight) else text)
    return prepared


def _values(override: Override) -> list[object]:
    """Return the values that an argument gives, of a range its description."""
    value = None if override.is_delete() else override.value()
    return list(value.list) if isinstance(value, ChoiceSweep) else [value]


def _constant(name: str, override: Override) -> str:
    """Return a number given for a schedule as a constant schedule; any other argument unchanged."""
    plain = [value.text if isinstance(value, QuotedString) else value for value in _values(override)]
    if any(not isinstance(value, int | float) or isinstance(value, bool) for value in plain):
        return str(override.input_line)
    return f"{name}=" + ",".join(f"{{start:{value},end:{value}}}" for value in plain)


def compose_training(arguments: Sequence[str], **kwargs: bool) -> DictConfig:
    """Return what Hydra makes of a training's arguments, without flags; ``kwargs`` are those of ``hydra.compose``."""
    with one_line_errors(), initialize_config_dir(str(CONF), version_base="1.3"):
        return compose("train", prepare(arguments), **kwargs)
