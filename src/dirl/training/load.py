"""Trained policies from checkpoints, with the conditions under which they are evaluated."""

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from torch import nn

from dirl.config.saved import read_config
from dirl.config.schemas import TrainConfig
from dirl.evaluation import EvaluationProtocol
from dirl.training.build import build_goals, build_observation, build_protocol, build_world, trained_policy


class Trained(NamedTuple):
    """A trained policy."""

    config: TrainConfig
    policy: nn.Module
    protocol: EvaluationProtocol
    """Where and how it is evaluated."""


def load_trained(
    saved: Mapping[str, Any],
    origin: str,
    changes: Mapping[str, Any] | None = None,
    trust: Collection[str] | None = (),
) -> Trained:
    """The policy of a checkpoint, in the world of its configuration.

    Args:
        saved: see `dirl.runs.folder.load_checkpoint`.
        origin: where it stood, for errors.
        changes: options to replace in its configuration, by dotted name.
        trust: packages whose classes it may name, see `dirl.config.components.find_class`.

    Raises:
        ConfigError: the configuration, or what it makes, cannot be used; or the weights do not fit.
        SceneError: a scene or goal that does not exist or cannot be used.
    """
    given = dict(changes or {})
    if "goals" in given:
        given.setdefault("hold_out", 0.0)
    # Goals that are drawn are drawn by the seed of the training: by another, trained ones would count as held out.
    seed = given.pop("seed", None)
    config = read_config(saved["config"], origin, given, trust)
    world = build_world(config)
    held_out = build_goals(config, world.scenes).held_out
    if seed is not None:
        config = replace(config, seed=seed)
    observation = build_observation(config, world)
    policy = trained_policy(saved, origin, config, world, observation)
    return Trained(config, policy, build_protocol(config, world, observation, held_out))
