"""The recogniser of a configuration, and the stop by it."""

import hashlib
from typing import Any

import torch
from torch import nn

from dirl.config.components import make
from dirl.config.files import group_options
from dirl.config.schemas import ConfigError, TrainConfig
from dirl.perception.recognition.matching import TemplateStop
from dirl.perception.recognition.recogniser import NCC, Recogniser, Thresholds


def matching(config: TrainConfig, device: torch.device | str) -> TemplateStop:
    """The stop by template matching, for a world on a device."""
    return stop_by(build_recogniser(config, device), config.stop.threshold, config.stop.match)


def stop_by(recogniser: Recogniser, threshold: float, match: str) -> TemplateStop:
    """The stop by a recogniser, above its own threshold or, if it has none, the one given."""
    if recogniser.thresholds is not None:
        threshold = recogniser.thresholds.photo if match == "front" else recogniser.thresholds.views
    return TemplateStop(threshold, match, recogniser)


def chosen_stop(choice: str, threshold: float, match: str) -> TemplateStop:
    """The stop by a recogniser that is named as in ``evaluate.py``: a choice of its group or a YAML file."""
    return stop_by(checked(make("recogniser", group_options("recogniser", choice) or {})), threshold, match)


def build_recogniser(config: TrainConfig, device: torch.device | str) -> Recogniser:
    """What the stop and the episodic memory recognise places by, on a device."""
    made: Any = make("recogniser", config.recogniser, config.trust) or NCC()
    return checked(made.to(device) if isinstance(made, nn.Module) else made)


def checked(recogniser: Any) -> Recogniser:
    """Return a recogniser that may be of a user's own; `ConfigError` if it lacks a member of `Recogniser`."""
    members = ("reads_patches", "calibrated", "thresholds", "fit", "describe", "scores")
    missing = [name for name in members if not hasattr(recogniser, name)]
    if missing:
        raise ConfigError(f"recogniser: {type(recogniser).__name__} has no {', '.join(missing)}")
    if not isinstance(recogniser.thresholds, Thresholds | None):
        raise ConfigError(
            f"recogniser: {type(recogniser).__name__}.thresholds must be Thresholds of dirl or None, "
            f"not {type(recogniser.thresholds).__name__}"
        )
    return recogniser


def recogniser_name(recogniser: Recogniser) -> str:
    """The class of a recogniser and a digest of its weights: what it describes others cannot compare."""
    kind = type(recogniser)
    digest = hashlib.sha256()
    if isinstance(recogniser, nn.Module):
        for name, value in sorted(recogniser.state_dict().items()):
            digest.update(name.encode() + value.detach().cpu().contiguous().numpy().tobytes())
    return f"{kind.__module__}.{kind.__qualname__} sha256:{digest.hexdigest()[:16]}"


def set_memory_threshold(memory: nn.Module | None, recogniser: Recogniser) -> None:
    """Give an episodic memory the threshold of its recogniser; one without a threshold weighs log odds itself.

    Raises:
        ConfigError: it does, and the recogniser's scores are no log odds.
    """
    if memory is None:
        return
    if not hasattr(memory, "threshold"):
        if not recogniser.calibrated:
            raise ConfigError(
                f"episodic_memory=localising weighs log odds, and {type(recogniser).__name__} has none: "
                "add recogniser=learned"
            )
    elif recogniser.thresholds is not None:
        memory.threshold = recogniser.thresholds.memory  # type: ignore[assignment]
