"""The choices of a group of ``conf/``, as options to change in a saved configuration."""

from collections.abc import Collection
from pathlib import Path
from typing import Any

import yaml  # PyYAML comes with OmegaConf
from omegaconf import OmegaConf

from dirl.config.components import TARGET, Options, make
from dirl.config.folders import CONF
from dirl.config.saved import MAX_CHARACTERS, plain_mapping
from dirl.config.schemas import ConfigError
from dirl.config.values import leaves


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
    made = make("simulator", own_options("simulator", Path(file)), trust)
    for name in ("name", "pose"):  # its methods have been looked for in its class
        if not hasattr(made, name):
            raise ConfigError(f"simulator={file}: {type(made).__name__} has no {name}; see dirl.scenes.live.Simulator")
    return made
