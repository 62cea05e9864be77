"""Saved configurations: written completely, and read without running or resolving anything in them."""

from collections.abc import Collection, Mapping
from typing import Any

import yaml  # PyYAML comes with OmegaConf
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from dirl.config.components import TARGET, check_components, moved
from dirl.config.schemas import ConfigError, TrainConfig
from dirl.config.values import leaves, plain, typed

MAX_CHARACTERS = 200_000
"""Of a saved configuration; those that are written here have 4,000."""

RENAMED: Mapping[str, str] = {
    "network.width": "encoder.width, heads.width",
    "network.heads": "heads",
    "imitation.share": "imitation.fraction",
    "imitation.enough": "imitation.loss_threshold",
    "imitation.keep": "imitation.bc_coef.start",
    "imitation.walk": "imitation.walk_steps",
    "objective.name": "objective",
    "objective.epochs": "reinforcement.epochs",
    "objective.minibatches": "reinforcement.minibatches",
    "objective.clip": "losses.ppo.clip_epsilon",
    "optimiser.name": "optimiser",
    "optimiser.max_norm": "reinforcement.max_grad_norm",
    "optimiser.clip_each": "reinforcement.clip_per_variable",
    "reinforcement.steps": "reinforcement.n_steps",
    "reinforcement.entropy": "reinforcement.entropy_coef.start",
    "reinforcement.final_entropy": "reinforcement.entropy_coef.end",
    "reinforcement.value": "reinforcement.critic_coef",
}
"""Options of schema 1 (dirl 0.1) by the names they have had since."""

SINCE: Mapping[str, str] = {"imitation.drawn": "imitation.sampled", "image_graph": "map"}
"""Options of 0.2 before its release by the names they have had since; a saved configuration is converted."""


def config_text(config: TrainConfig) -> str:
    """A configuration as YAML, without interpolations and without what it was started with (``resume``, ``trust``)."""
    return OmegaConf.to_yaml(OmegaConf.create(plain(config)))


def read_config(
    text: str, origin: str, changes: Mapping[str, Any] | None = None, trust: Collection[str] = ()
) -> TrainConfig:
    """A configuration that a run saved. Its components' classes are found and checked, but not instantiated.

    Args:
        text: YAML.
        origin: where it stood, for errors.
        changes: values to replace in it, by dotted name; a mapping replaces a mapping as a whole.
        trust: packages whose classes it may name, see `dirl.config.components.find_class`.

    Raises:
        ConfigError: it is not one of this version, names an untrusted package, or a change is invalid.
    """
    try:
        values = plain_mapping(text)
        if isinstance(values.get("objective"), dict):
            try:
                values = _of_schema_1(values)
            except (AttributeError, TypeError) as error:  # a group or name of another type
                raise ConfigError(f"a value of schema 1 is not of its type ({error})") from None
        values = _with_source(_moved(_since(values))) | {"resume": None, "trust": list(trust)}
        for name, value in (changes or {}).items():
            _replace(values, name, value)
        config: TrainConfig = typed(OmegaConf.merge(OmegaConf.structured(TrainConfig), values))  # type: ignore[arg-type]
        check_components(config, trust)
    except (OmegaConfBaseException, yaml.YAMLError, ConfigError, KeyError, RecursionError) as error:
        reason = " ".join(f"lacks {error}".split() if isinstance(error, KeyError) else str(error).split())
        raise ConfigError(f"{origin}: holds no configuration of this version of dirl: {reason}") from None
    return config


class _PlainLoader(yaml.SafeLoader):
    """YAML without aliases, which could make a few lines expand to gigabytes."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.events.AliasEvent):
            raise ConfigError("it has YAML aliases, which no configuration of dirl has")
        return super().compose_node(parent, index)


def plain_mapping(text: str) -> dict[str, Any]:
    """YAML as plain values.

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


def _since(values: dict[str, Any]) -> dict[str, Any]:
    """The values with the options and the rules of goals that had another name before 0.2 was released."""
    imitation = values.get("imitation")
    if isinstance(imitation, dict):
        imitation = {"sampled" if name == "drawn" else name: value for name, value in imitation.items()}
        values = {**values, "imitation": {**imitation, "goals": _fractions(imitation.get("goals"))}}
    return {**values, "goals": _fractions(values.get("goals"))}


def _fractions(goals: Any) -> Any:
    """Goals by rule, with ``fraction:S`` for ``share:S``."""
    if isinstance(goals, dict):
        return {name: _fractions(rule) for name, rule in goals.items()}
    return f"fraction:{goals[6:]}" if isinstance(goals, str) and goals.startswith("share:") else goals


def _moved(values: Any) -> Any:
    """The values with the classes that they name where these are today."""
    if isinstance(values, dict):
        return {name: _moved(value) for name, value in values.items()}
    if isinstance(values, list):
        return [_moved(value) for value in values]
    return moved(values) if isinstance(values, str) else values


def _with_source(values: dict[str, Any]) -> dict[str, Any]:
    """The values with the class of the source, which had a name before 0.3."""
    source = values.get("source")
    if not isinstance(source, dict) or "name" not in source:
        return values
    thor = {TARGET: "dirl.scenes.catalogue.Thor", "root": source.get("root")}
    return values | {"source": thor if source["name"] == "thor" else {TARGET: "dirl.scenes.catalogue.Rooms"}}


def _replace(values: dict[str, Any], name: str, value: Any) -> None:
    """Set a value by its dotted name."""
    *above, last = name.split(".")
    for part in above:
        values = values.setdefault(part, {})
    values[last] = value


def _of_schema_1(old: dict[str, Any]) -> dict[str, Any]:
    """A configuration of schema 1 converted to the current one, as far as evaluation, Navigator and reports need it."""
    before, network = leaves(old), old["network"]
    gone = ("objective", "network", "optimiser", "policy", "observation")
    values = {name: value for name, value in old.items() if name not in gone}
    for group in ("imitation", "reinforcement"):
        values[group] = {key: value for key, value in old[group].items() if f"{group}.{key}" not in RENAMED}
    for name, new in RENAMED.items():
        if new.split(".")[0] in ("imitation", "reinforcement"):
            _replace(values, new, before[name])
    _replace(values, "imitation.bc_coef.end", 0.0)
    views = {"surrounding": "SurroundingViews", "sequential": "SequentialViews"}
    policies = {"network": "dirl.models.ActorCritic", "random": "dirl.evaluation.experts.RandomPolicy"}
    heads = {"width": network["width"], "shared": network["heads"] == "shared"}
    losses = {"a2c": "torchrl.objectives.A2CLoss", "ppo": "torchrl.objectives.ClipPPOLoss"}
    objective = before["objective.name"]
    return values | {
        "observation": {"_target_": f"dirl.envs.{views[old['observation']]}"},
        "encoder": {"_target_": "dirl.models.SiameseEncoder", "width": network["width"]},
        "memory": {"_target_": None},
        "heads": {"_target_": "dirl.models.ActorCriticHeads", **heads},
        "policy": {"_target_": policies.get(old["policy"], "dirl.evaluation.experts.ShortestPathPolicy")},
        "expert": {"_target_": "dirl.evaluation.experts.ShortestPathExpert"},
        "losses": {objective: {"_target_": losses[objective]}} if objective in losses else {},
        "optimiser": {"_target_": "torch.optim.Adam", "lr": before["optimiser.lr"], "eps": before["optimiser.eps"]},
        "network": {"standardise": network["standardise"], "cache": "auto", "axes": network["axes"]},
        "env": {"_target_": "dirl.envs.NavigationEnv", "slip": 0.0},
    }
