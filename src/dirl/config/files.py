"""Configurations: their values, typed and plain, and their files.

Files are those of runs, choices of a group of ``conf/``, and components of the user's own. A run saves its
configuration completely. All are read without running or resolving anything in them.
"""

from collections.abc import Collection, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import yaml  # PyYAML comes with OmegaConf
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from dirl.config.components import PUBLIC, TARGET, Options, check_components, check_value, make
from dirl.config.folders import CONF
from dirl.config.schemas import ConfigError, TrainConfig, option_types

MAX_CHARACTERS = 200_000
"""Of a saved configuration; those that are written here have 4,000."""


def typed(config: DictConfig) -> Any:
    """Return the dataclass of a composed configuration.

    Raises:
        ConfigError: a value is missing, of the wrong type, or outside its limits.
    """
    try:
        options = OmegaConf.to_object(config)
        for name, value in config.items():
            if isinstance(value, DictConfig) and OmegaConf.get_type(value) is dict:  # plain, also what is interpolated
                setattr(options, str(name), OmegaConf.to_container(value, resolve=True, enum_to_str=True))
    except OmegaConfBaseException as error:
        raise ConfigError(f"{error.full_key or 'an option'}: {str(error).splitlines()[0]}") from None
    scene = OmegaConf.select(config, "scene")
    for name_of_scene in scene if OmegaConf.is_list(scene) else [scene]:
        if name_of_scene is not None and not isinstance(name_of_scene, str):
            raise ConfigError(f"scene={scene}: must be a name, a path, or a list of them")
    for name, kind in option_types(type(options), bounds=True).items():
        value = OmegaConf.select(config, name)
        if type(value) in (int, float):  # of other values OmegaConf has checked the types
            check_value(name, value, kind)
    return options


def leaves(config: Any, prefix: str = "") -> dict[str, Any]:
    """Return the values of a nested configuration by dotted name; goals and lists are values."""
    values: dict[str, Any] = {}
    for name, value in config.items():
        inside = isinstance(value, Mapping) and name != "goals"
        values |= leaves(value, f"{prefix}{name}.") if inside else {f"{prefix}{name}": value}
    return values


def names(option: str, value: object) -> list[str]:
    """Return the names that an option gives, one or a list of them; `ConfigError` if it gives something else."""
    given = value if isinstance(value, list) else [value]
    if not given or not all(isinstance(name, str | int) and not isinstance(name, bool) for name in given):
        raise ConfigError(f"{option}={value}: must be the name of a file or a folder, or a list of them")
    return [str(name) for name in given]


def config_text(config: TrainConfig) -> str:
    """Return a configuration as YAML, without interpolations, and without ``out``, ``resume`` and ``trust``."""
    return OmegaConf.to_yaml(OmegaConf.create({**asdict(config), "out": None, "resume": None, "trust": None}))


def read_config(
    text: str, origin: str, changes: Mapping[str, object] | None = None, trust: Collection[str] = ()
) -> TrainConfig:
    """Return a configuration that a run saved. Its components' classes are found and checked, but not made.

    Args:
        text: YAML.
        origin: where it stood, for errors.
        changes: values to replace in it, by dotted name; a mapping replaces a mapping as a whole. They are the user's
            own, and so are trusted.
        trust: packages whose classes it may name, see `dirl.config.components.find_class`.

    Raises:
        ConfigError: it is not one of this version, names an untrusted package, or a change is invalid.
    """
    try:
        named = [
            str(value[TARGET]) for value in (changes or {}).values() if isinstance(value, Mapping) and value.get(TARGET)
        ]
        own = [target.partition(".")[0] for target in named if target not in PUBLIC and not target.startswith("dirl.")]
        trust = [*trust, *own]  # the user names these
        values = plain_mapping(text) | {"resume": None, "trust": trust}
        for name, value in (changes or {}).items():
            _replace(values, name, value)
        config: TrainConfig = typed(OmegaConf.merge(OmegaConf.structured(TrainConfig), values))  # type: ignore[arg-type]
        check_components(config, trust)
    except (OmegaConfBaseException, yaml.YAMLError, ConfigError, RecursionError) as error:
        reason = " ".join(str(error).split())
        raise ConfigError(f"{origin}: holds no configuration of this version of dirl: {reason}") from None
    return config


class _PlainLoader(yaml.SafeLoader):
    """YAML without aliases, which could make a few lines expand to gigabytes."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.events.AliasEvent):
            raise ConfigError("it has YAML aliases, which no configuration of dirl has")
        return super().compose_node(parent, index)


def plain_mapping(text: str) -> dict[str, Any]:
    """Return YAML as plain values.

    Raises:
        ConfigError: it is too long, is no mapping, or has interpolations, which could read the environment.
    """
    if len(text) > MAX_CHARACTERS:
        raise ConfigError(f"it has {len(text)} characters; at most {MAX_CHARACTERS} are read")
    try:
        values = yaml.load(text, _PlainLoader)
    except ConfigError:
        raise
    except (AttributeError, ValueError, TypeError) as error:  # of a value that is not what its tag says
        raise ConfigError(f"a value is not of its type ({error})") from None
    if not isinstance(values, dict) or not all(isinstance(name, str) for name in values):
        raise ConfigError("it is no mapping of options")
    if "${" in str(values):
        raise ConfigError("it has an interpolation, ${...}, which is not resolved in a file")
    return values


def _replace(values: dict[str, Any], name: str, value: object) -> None:
    """Set a value by its dotted name."""
    *above, last = name.split(".")
    for part in above:
        values = values.setdefault(part, {})
    values[last] = value


def group_options(group: str, choice: str | None) -> Options | None:
    """Return the options of a choice; None if nothing is chosen.

    It is the name of a file in the folder ``group`` of ``conf/``, or the path of a file of one's own, with ``.yaml``.

    Raises:
        ConfigError: the group has no such choice, or the file is none.
    """
    if choice is None:
        return None
    if choice.endswith(".yaml"):
        return own_options(group, Path(choice))
    file = CONF / group / f"{choice}.yaml"
    choices = sorted(path.stem for path in file.parent.glob("*.yaml"))
    if choice not in choices:
        raise ConfigError(f"{group}={choice}: choose from {', '.join(choices)}, or a file of your own, with .yaml")
    options: Any = OmegaConf.to_container(OmegaConf.load(file))
    return dict(options)


def own_options(group: str, file: Path) -> Options:
    """Return a component's options in a YAML file of the user's; ``group`` is the option that names it.

    Raises:
        ConfigError: it cannot be read, or names no class.
    """
    if not file.is_file():
        raise ConfigError(f"{group}={file}: there is no such file")
    try:
        with file.open("rb") as stream:
            options = plain_mapping(stream.read(MAX_CHARACTERS + 1).decode())
    except (OSError, ValueError, yaml.YAMLError, RecursionError) as error:
        reason = error.strerror if isinstance(error, OSError) else " ".join(str(error).split())
        raise ConfigError(f"{group}={file}: cannot be read as options: {reason}") from None
    if TARGET not in options:
        raise ConfigError(f"{group}={file}: has no {TARGET}, which names the class")
    return options


def goal_view_options(choice: str | None) -> Options:
    """Return the options by which goals are shown, by dotted name; none if nothing is chosen."""
    if choice == "surrounding":  # in training the defaults, which a run on photos has replaced
        return {"observation.goal_view": "surrounding", "stop.match": "views", "stop.threshold": 0.9}
    return leaves(group_options("goal_view", choice) or {})


def load_simulator(file: str, trust: Collection[str] | None = None) -> Any:
    """Return the simulator of the user's own that a YAML file names: ``_target_``, its class, and its arguments.

    ``trust`` is as for `dirl.config.components.find_class`.

    Raises:
        ConfigError: there is no such file or class, or it lacks a member of `dirl.scenes.live.Simulator`.
    """
    world = make("simulator", own_options("simulator", Path(file)), trust)
    for name in ("name", "pose"):  # its methods have been looked for in its class
        if not hasattr(world, name):
            raise ConfigError(f"simulator={file}: {type(world).__name__} has no {name}; see dirl.scenes.live.Simulator")
    return world
