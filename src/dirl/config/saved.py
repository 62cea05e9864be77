"""Saved configurations: written completely, and read without running or resolving anything in them."""

from collections.abc import Collection, Mapping
from typing import Any

import yaml  # PyYAML comes with OmegaConf
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from dirl.config.components import PUBLIC, TARGET, check_components
from dirl.config.schemas import ConfigError, TrainConfig
from dirl.config.values import plain, typed

MAX_CHARACTERS = 200_000
"""Of a saved configuration; those that are written here have 4,000."""


def config_text(config: TrainConfig) -> str:
    """Return a configuration as YAML, without interpolations, and without ``out``, ``resume`` and ``trust``."""
    return OmegaConf.to_yaml(OmegaConf.create(plain(config)))


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
        trust = [*trust, *_named_by_user(changes or {})]
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


def _named_by_user(changes: Mapping[str, object]) -> list[str]:
    """Return the packages of the classes that changes name."""
    named = [str(value[TARGET]) for value in changes.values() if isinstance(value, Mapping) and value.get(TARGET)]
    return [target.partition(".")[0] for target in named if target not in PUBLIC and not target.startswith("dirl.")]


def _replace(values: dict[str, Any], name: str, value: object) -> None:
    """Set a value by its dotted name."""
    *above, last = name.split(".")
    for part in above:
        values = values.setdefault(part, {})
    values[last] = value
