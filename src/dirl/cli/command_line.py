"""The command-line interface of the recipes: names for Hydra, and errors of one line."""

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NoReturn

from hydra._internal.utils import get_args_parser
from hydra.core.config_store import ConfigStore
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import ChoiceSweep, Override, QuotedString, Sweep
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from dirl.config.components import GROUPS
from dirl.config.conf_schemas import SCHEMAS
from dirl.config.schemas import ConfigError, Schedule, Weight
from dirl.config.values import check_choice, misfit, option_types
from dirl.runs.errors import one_line


def register() -> None:
    """Give Hydra the types, and the resolver that names a run's folder."""
    store = ConfigStore.instance()
    for name, schema in SCHEMAS.items():
        store.store(f"{name}_schema", schema)
    OmegaConf.register_new_resolver("run_folder", _run_folder, replace=True)


def _run_folder(resume: str | None, system: str, scene: Any, time: str) -> str:
    """The folder to resume, or ``runs/dirl_bathroom_02/<time>`` (several scenes joined by +, the stems of files)."""
    scenes = list(map(str, scene)) if OmegaConf.is_list(scene) else [str(scene or "nowhere")]
    return resume or f"runs/{system}_{'+'.join(Path(name).stem for name in scenes)}/{time}"


def choose_command(commands: Mapping[str, str], arguments: Sequence[str], text: str) -> tuple[str, list[str]]:
    """The command that a command line begins with, and what follows it.

    Args:
        commands: what each one does, by name.
        arguments: the command line after the program.
        text: printed above the list of commands, for ``--help`` or no arguments at all.

    Raises:
        ConfigError: there is no such command.
        SystemExit: help was asked for.
    """
    if not arguments or arguments[0] in ("--help", "-h"):
        lines = [f"  {name:<10} {meaning}" for name, meaning in commands.items()]
        print("\n".join([text.strip(), "", *lines, "", "<command> --help tells the options of one."]))
        raise SystemExit(0)
    name, *rest = arguments
    check_choice(f"command '{name}'", name, commands)
    return name, rest


def prepare(schema: type, arguments: Sequence[str], conf: Path | None = None) -> list[str]:
    """Check a command line's ``name=value`` arguments, and write them as Hydra takes them.

    Hydra's own messages take many lines and list no choices. The options of components are checked later, against the
    constructor of the class that is chosen (`dirl.config.components`); here they only get the ``++`` by which Hydra
    takes options that the class has and its YAML does not list.

    Args:
        schema: what the recipe takes.
        arguments: the command line after the program.
        conf: the folder of configurations; its folders are groups to choose from.

    Returns:
        The arguments for Hydra.

    Raises:
        ConfigError: there is no such option or choice, or its value is of another type.
    """
    if arguments and arguments[0] in ("-sc", "--shell-completion"):  # its install=bash is no option of a recipe
        return list(arguments)
    _check_flags(arguments)
    known = option_types(schema)
    folders = [] if conf is None else [conf, *config_dirs(arguments)]
    sweeps = any(text in ("-m", "--multirun") for text in arguments)
    trial = OmegaConf.structured(schema)
    prepared = []
    for text in arguments:
        override = parsed(text)
        if override is not None and override.is_sweep_override() and not sweeps:
            raise ConfigError(f"{text}: several values are a sweep; add -m, or write a list as name=[a,b]")
        name = "" if override is None else override.key_or_group
        if override is None or name.split("/")[0].split(".")[0] == "hydra":
            prepared.append(text)
        elif any((folder / name).is_dir() for folder in folders):
            _check_choice(name, override, folders)
            prepared.append(text)
        elif conf is not None and "." in name and name.split(".")[0] in GROUPS:
            prepared.append(text if text.startswith(("+", "~")) else f"++{text}")
        else:
            _check_name(known, name)
            constant = _constant(name, override) if known[name] in (Schedule, Weight) else text
            prepared.append(constant)
            if constant == text:
                _check_value(trial, name, known[name], override)
    return prepared


def _check_flags(arguments: Sequence[str]) -> None:
    """Raise `ConfigError` unless all is a flag that Hydra takes, or an option; itself it would print a usage."""

    def refuse(message: str) -> NoReturn:
        late = message.startswith("unrecognized arguments") and "=" in message and not message.count(" -")
        hint = "flags such as -m come before options" if late else "--hydra-help tells the flags, --help the options"
        raise ConfigError(f"{message}; {hint}")

    parser = get_args_parser()
    parser.error = refuse  # type: ignore[method-assign]
    given = parser.parse_args([text for text in arguments if text != "--version"])
    if given.experimental_rerun is not None:
        raise ConfigError("--experimental-rerun: reads a pickle, which can run code; use resume=<the folder of a run>")
    for text in given.overrides:
        if text.startswith("=") or not any(sign in text for sign in "=~"):
            raise ConfigError(f"{one_line(text) or 'an empty text'}: is not of the form name=value")
    for folder in config_dirs(arguments):
        if not folder.is_dir():
            raise ConfigError(f"--config-dir {folder}: there is no such folder")


def parsed(text: str) -> Override | None:
    """An argument as an override; None if it is a flag, or what follows one.

    Raises:
        ConfigError: it has another form than Hydra takes.
    """
    if text.startswith("-") or not any(sign in text for sign in "=~"):
        return None
    try:
        return OverridesParser.create().parse_override(text)
    except HydraException as error:
        place = one_line(str(error).splitlines()[0]).partition(" expecting ")[0]
        raise ConfigError(
            f"{one_line(text)}: is not of the form name=value ({place}); quote a text with such signs: 'name=\"...\"'"
        ) from None


def config_dirs(arguments: Sequence[str]) -> list[Path]:
    """The folders that ``--config-dir`` names."""
    joined = [text.partition("=")[2] for text in arguments if text.startswith("--config-dir=")]
    apart = [after for text, after in pairwise(arguments) if text in ("--config-dir", "-cd")]
    return [Path(folder) for folder in joined + apart]


def _check_choice(group: str, override: Override, folders: Sequence[Path]) -> None:
    """Raise `ConfigError` unless the group has this choice."""
    choices = sorted({file.stem for folder in folders for file in (folder / group).glob("*.yaml")})
    for one in _values(override):
        for choice in one if isinstance(one, list) else [one]:
            if choice is not None:
                check_choice(f"{group}={choice}", str(choice), choices, f"{group}=")


def _check_name(known: Mapping[str, Any], name: str) -> None:
    """Raise `ConfigError` unless there is such an option."""
    if name in known:
        return
    level, _, last = name.rpartition(".")
    inside = {other.split(".")[-1]: other for other in known if other.rpartition(".")[0] == level}
    near = [other for other in known if other.split(".")[-1] == last]
    near = near or [inside[match] for match in difflib.get_close_matches(last, inside, n=3)]
    choices = ", ".join(inside.values() or (option for option in known if "." not in option))
    hint = f"did you mean {' or '.join(near)}?" if near else f"choose from {choices}"
    raise ConfigError(f"there is no option '{name}'; {hint}")


def _constant(name: str, override: Override) -> str:
    """A number given for a schedule, as a constant schedule; any other argument unchanged."""
    values = _values(override)
    if not values or any(isinstance(value, dict | str | bool) for value in values):
        return str(override.input_line)
    return f"{name}=" + ",".join(f"{{start:{value},end:{value}}}" for value in values)


def _values(override: Override) -> list[Any]:
    """The values of an override: one, or those of a sweep's list; empty for other sweeps and for deletions."""
    if override.is_delete():
        return []
    value = override.value()
    several = value.list if isinstance(value, ChoiceSweep) else [] if isinstance(value, Sweep) else [value]
    return [one.text if isinstance(one, QuotedString) else one for one in several]


def _check_value(trial: DictConfig, name: str, kind: Any, override: Override) -> None:
    """Raise `ConfigError` unless OmegaConf can convert each value to the type of the option, by trying it."""
    if is_dataclass(kind):
        if not all(isinstance(given, dict) for given in _values(override)):
            inside = ", ".join(f"{name}.{option.name}" for option in fields(kind))
            raise ConfigError(f"{override.input_line}: {name} is a group of options: {inside}")
        return
    for given in _values(override):
        wrong = ""
        try:
            OmegaConf.update(trial, name, given)
        except OmegaConfBaseException as error:
            wrong = misfit(given, kind) or str(error).splitlines()[0]
        # OmegaConf takes a list where an element of a list should be a number.
        if isinstance(given, list) and any(isinstance(one, list | dict) for one in given):
            wrong = misfit(given, kind)
        if wrong:
            raise ConfigError(f"{name}={'null' if given is None else given}: {wrong}")
