"""The components of a navigator, from a checkpoint."""

import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from dirl.agent.images import NavigatorError
from dirl.backbones import ViewEncoder, load_encoder
from dirl.backbones.patches import PATCH_SHAPE
from dirl.backbones.registry import BATCH
from dirl.config.schemas import ConfigError, Match, TrainConfig
from dirl.envs.transforms import VIEWS
from dirl.models import FeatureTable
from dirl.models.build import build_policy, reads_patches, saved_statistics
from dirl.models.weights import check_extractor, load_weights

Encoder = Callable[[Tensor], Any]
"""RGB images, uint8 ``[N, H, W, 3]`` on the navigator's device, to features ``[N, D]``, torch or numpy."""


def check_encoder(encoder: Encoder | str | Path, given: str | None, saved: Mapping[str, Any], origin: str) -> None:
    """Raise `NavigatorError` unless the encoder, or the caller, names the extractor of the training's features."""
    if given is None and isinstance(encoder, ViewEncoder):
        given = encoder.extractor
    if given is None and callable(encoder):
        raise NavigatorError(
            "say which extractor this function is with extractor=...; "
            f"the checkpoint was trained with '{saved['extractor']}'"
        )
    if given is not None:
        _check_extractor(saved, given, origin)


def _check_extractor(saved: Mapping[str, Any], extractor: str, origin: str, hint: str = "") -> None:
    """`check_extractor` with the error of a navigator."""
    try:
        check_extractor(saved, extractor, origin)
    except ConfigError as error:
        raise NavigatorError(f"{error}{hint}") from None


def choose_scene(scene: str | None, scenes: list[str], *, shared: bool) -> str | None:
    """The name of the scene's layers in the network; None for shared ones."""
    if scene is None and not shared and len(scenes) > 1:
        raise NavigatorError(f"say in which scene the agent is by scene=...; choose from {scenes}")
    if scene is not None and scene not in scenes:
        raise NavigatorError(f"the checkpoint was not trained in '{scene}'; choose from {scenes}")
    return None if shared else (scene or scenes[0])


def matched_view(config: TrainConfig, order: list[str]) -> int | None:
    """The index of the view that is matched with the goal's; None for all four."""
    if order[-1] == "now":
        return VIEWS - 1  # the newest, the only one from where the agent is now
    return 0 if config.stop.match == Match.front else None


def rebuild(saved: dict[str, Any], config: TrainConfig, scene: str | None, origin: str) -> nn.Module:
    """The trained policy with the layers of one scene, and an empty table of features."""
    weights = saved["network"]
    mean = weights.get("features.mean", weights.get("encoder.table.mean"))
    if mean is None:
        raise NavigatorError(f"{origin}: the weights do not fit a policy on features; they lack features.mean")
    names = [scene or saved["scenes"][0]]
    try:
        patches = torch.empty(0, *PATCH_SHAPE) if reads_patches(config) else None
        table = FeatureTable(torch.empty(0, len(mean)), *saved_statistics(weights, origin), patches)
        policy = build_policy(config, table, names)
        load_weights(policy, weights, origin, names)
    except ConfigError as error:
        raise NavigatorError(str(error)) from None
    return policy.requires_grad_(False)


def encoder_of_images(
    name: str | Path,
    device: str | torch.device,
    saved: Mapping[str, Any],
    origin: str,
    *,
    confirmed: bool,
    patches: bool,
) -> Encoder:
    """Load an encoder by name or from a file, and compare it with the extractor of the training unless confirmed.

    The result takes any number of images. With ``patches`` the patch features follow the pooled ones.
    """
    encoder = load_encoder(str(name), device, patches=patches)
    if not confirmed and not Path(name).is_file():
        hint = f" (encoder={name}); if both names mean the same, confirm it with extractor=..."
        _check_extractor(saved, encoder.extractor, origin, hint)
    elif not confirmed and encoder.extractor != saved["extractor"]:
        warnings.warn(
            f"the weights in {name} are '{encoder.extractor}', and the checkpoint was trained with "
            f"'{saved['extractor']}'; if they are the same, confirm it with extractor=...",
            stacklevel=3,
        )
    return lambda images: torch.cat([_both(encoder, part) for part in images.split(BATCH)])


def _both(encoder: ViewEncoder, images: Tensor) -> Tensor:
    if encoder.forward_patches is None:
        return encoder(images)
    pooled, patches = encoder.forward_patches(images)
    return torch.cat([pooled, patches.flatten(1).to(pooled)], 1)
