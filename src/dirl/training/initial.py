"""Fine-tuning: a training that begins with the weights of another one (``init``)."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from torch import Tensor

from dirl.config.saved import read_config
from dirl.config.schemas import ConfigError, TrainConfig
from dirl.models.weights import check_extractor
from dirl.runs.checkpoints import load_checkpoint
from dirl.runs.finding import ARCHITECTURE, initial_weights_file
from dirl.scenes import World


def with_architecture(config: TrainConfig, overrides: Sequence[str]) -> tuple[TrainConfig, Mapping[str, Any] | None]:
    """The configuration with the architecture of the checkpoint that ``init`` names; unchanged without it.

    Args:
        config: as composed.
        overrides: of the command line.

    Returns:
        The configuration, and the checkpoint, for `initial_weights`; None without ``init``.

    Raises:
        ConfigError: an option of the architecture is given beside ``init``.
        RunError: there is no such checkpoint, or it is damaged.
    """
    if config.init is None:
        return config, None
    saved = load_checkpoint(initial_weights_file(config.init, overrides))
    trained = read_config(saved["config"], config.init, trust=config.trust or [])
    return replace(config, **{name: getattr(trained, name) for name in ARCHITECTURE}), saved


def initial_weights(
    config: TrainConfig, world: World, saved: Mapping[str, Any] | None = None
) -> Mapping[str, Tensor] | None:
    """The weights that a training begins with, by name; None without ``init``.

    Args:
        config: of the run, see `with_architecture`.
        world: where it walks.
        saved: the checkpoint that ``init`` names, if it has been read; or the one that the run itself resumes from.

    Raises:
        ConfigError: they were trained on the features of another extractor, or have heads for other scenes.
        RunError: there is no such checkpoint, or it is damaged.
    """
    if config.init is None:
        return None
    saved = saved or load_checkpoint(config.init)
    check_extractor(saved, world.scenes[0].extractor, f"init={config.init}")
    unknown = sorted(set(world.names) - set(saved["scenes"]))
    if unknown and not config.heads.get("shared"):
        raise ConfigError(f"init={config.init}: has heads for the scenes {saved['scenes']}, none for {unknown[0]}")
    weights: Mapping[str, Tensor] = saved["network"]
    return weights
