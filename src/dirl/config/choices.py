"""The choices of a group of ``conf/``, as options to change in a saved configuration."""

from typing import Any

from omegaconf import OmegaConf

from dirl.config.places import CONF
from dirl.config.schemas import ConfigError, leaves


def group_options(group: str, choice: str | None) -> dict[str, Any] | None:
    """The options of a choice; None if nothing is chosen.

    Raises:
        ConfigError: the group has no such choice.
    """
    if choice is None:
        return None
    file = CONF / group / f"{choice}.yaml"
    choices = sorted(path.stem for path in file.parent.glob("*.yaml"))
    if choice not in choices:
        raise ConfigError(f"{group}={choice}: choose from {', '.join(choices)}")
    options: Any = OmegaConf.to_container(OmegaConf.load(file))
    return dict(options)


def goal_view_options(choice: str | None) -> dict[str, Any]:
    """The options by which goals are shown, by dotted name; none if nothing is chosen."""
    if choice == "surrounding":  # in training the defaults, which a run on photos has replaced
        return {"observation.goal_view": "surrounding", "stop.match": "views", "stop.threshold": 0.9}
    return leaves(group_options("goal_view", choice) or {})
