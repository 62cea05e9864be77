"""The components of a navigator, from a checkpoint."""

import warnings
from collections.abc import Callable, Collection, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from dirl.agent.cameras import FeaturePolicy
from dirl.agent.images import NavigatorError
from dirl.config.components import TARGET, find_class, make
from dirl.config.files import group_options, read_config
from dirl.config.schemas import ConfigError, Match, TrainConfig
from dirl.envs.transforms import VIEWS
from dirl.models import FeatureTable
from dirl.models.build import build_policy, check_extractor, load_weights, pixels_read, reads_patches, saved_statistics
from dirl.perception.backbones import ViewEncoder, load_encoder
from dirl.perception.backbones.patches import PATCH_SHAPE, coarse
from dirl.perception.backbones.registry import BATCH, LITE, packaged_encoder
from dirl.perception.recognition.learned import Learned
from dirl.perception.recognition.recogniser import build_recogniser, set_memory_threshold

Encoder = Callable[[Tensor], Any]
"""RGB images, uint8 ``[N, H, W, 3]`` on the navigator's device, to features ``[N, D]``, torch or numpy."""


def load_parts(
    saved: dict[str, Any],
    origin: str,
    encoder: Encoder | str | Path | None,
    extractor: str | None,
    scene: str | None,
    chosen: Mapping[str, str | None],
    device: str | torch.device,
    trust: Collection[str],
) -> dict[str, Any]:
    """Return the parts of a `dirl.Navigator`, by name, from a checkpoint of ``origin``; see `Navigator.load`.

    ``chosen`` replaces the checkpoint's options of component groups.
    """
    if torch.device(device).type == "cuda" and not torch.cuda.is_available():
        raise NavigatorError(f"device={device}: torch sees no CUDA device here; use device='cpu'")
    changes = {name: options for name, choice in chosen.items() if (options := group_options(name, choice))}
    config = read_config(saved["config"], origin, changes, trust)
    encoder = encoder or packaged_encoder(saved["extractor"])  # which made the features of the training
    if encoder is None:
        raise NavigatorError(
            f"{origin}: was trained on features of '{saved['extractor']}', which is no encoder of dirl; name it, or "
            "give a function of images: encoder=..."
        )
    patches, recognises = reads_patches(config), build_recogniser(config.recogniser, device, config.trust)
    gives_fine = encoder == LITE or (isinstance(encoder, ViewEncoder) and encoder.fine)
    fine = patches and isinstance(recognises, Learned) and gives_fine  # photos are recognised by them
    encodes = image_encoder(encoder, extractor, saved, origin, device, patches=patches, fine=fine)
    own: list[str] = list(find_class("observation", config.observation[TARGET], trust).order)  # type: ignore[attr-defined]
    order = saved["views"]
    if order != own:
        raise NavigatorError(f"{origin}: was trained on the views {order}, not {own}")
    if len(order) != VIEWS:
        raise NavigatorError(f"{origin}: was trained on {len(order)} views; a navigator takes {VIEWS}")
    scenes, shared = saved["scenes"], bool(config.heads.get("shared"))
    if scene is None and not shared and len(scenes) > 1:
        raise NavigatorError(f"say in which scene the agent is by scene=...; choose from {scenes}")
    if scene is not None and scene not in scenes:
        raise NavigatorError(f"the checkpoint was not trained in '{scene}'; choose from {scenes}")
    scene = None if shared else scene or scenes[0]
    sequential = order[-1] == "now"  # only the newest view is from where the agent is now
    matched = VIEWS - 1 if sequential else 0 if config.stop.match == Match.front else None
    policy = FeaturePolicy(rebuild(saved, config, scene, origin), matched)
    memory = make("episodic_memory", config.episodic_memory, trust)
    set_memory_threshold(memory, recognises)
    if memory is not None and sequential:
        raise NavigatorError(
            f"{origin}: an episodic memory recognises places by surrounding views; this policy sees others"
        )
    return {
        "policy": policy.to(device).eval(),
        "encoder": encodes,
        "view_order": order,
        "threshold": config.stop.threshold,
        "facts": {"scene": scene or "any", "extractor": saved["extractor"]},
        "memory": memory,
        "recogniser": recognises,
        "fine": fine,
        "pixels": pixels_read(config),
    }


def image_encoder(
    encoder: Encoder | str | Path,
    extractor: str | None,
    saved: Mapping[str, Any],
    origin: str,
    device: str | torch.device,
    *,
    patches: bool,
    fine: bool = False,
) -> Encoder:
    """Return the given encoder, or load it by name or file; with ``patches`` their features follow the pooled ones.

    With ``fine`` they are followed by those of fine patches. A function gives all that is needed by itself.

    Raises:
        NavigatorError: it is another extractor than the training's, unless ``extractor`` confirms it; or a function
            that nobody says the extractor of.
    """
    named = isinstance(encoder, str | Path)
    loaded = load_encoder(str(encoder), device, patches=patches, fine_patches=fine) if named else encoder
    known = loaded.extractor if extractor is None and isinstance(loaded, ViewEncoder) else extractor
    if known is None:
        raise NavigatorError(
            "say which extractor this function is with extractor=...; "
            f"the checkpoint was trained with '{saved['extractor']}'"
        )
    if extractor is None and named and Path(encoder).is_file():  # type: ignore[arg-type]
        if known != saved["extractor"]:
            warnings.warn(
                f"the weights in {encoder} are '{known}', and the checkpoint was trained with "
                f"'{saved['extractor']}'; if they are the same, confirm it with extractor=...",
                stacklevel=3,
            )
    else:
        try:
            check_extractor(saved, known, origin)
        except ConfigError as error:
            hint = f" (encoder={encoder}); if both names mean the same, confirm it with extractor=..."
            raise NavigatorError(f"{error}{hint if extractor is None and named else ''}") from None
    return partial(_encoded, loaded, patches, fine) if isinstance(loaded, ViewEncoder) else loaded  # type: ignore[return-value]


def rebuild(saved: dict[str, Any], config: TrainConfig, scene: str | None, origin: str) -> nn.Module:
    """Return the trained policy with the layers of one scene, and an empty table of features."""
    weights, names = saved["network"], [scene or saved["scenes"][0]]
    if "features.mean" not in weights:
        raise NavigatorError(f"{origin}: the weights do not fit a policy on features; they lack features.mean")
    try:
        patches = torch.empty(0, *PATCH_SHAPE) if reads_patches(config) else None
        features = torch.empty(0, len(weights["features.mean"]))
        policy = build_policy(config, FeatureTable(features, *saved_statistics(weights), patches), names)
        load_weights(policy, weights, origin, names)
    except ConfigError as error:
        raise NavigatorError(str(error)) from None
    return policy.requires_grad_(False)


def _encoded(encoder: ViewEncoder, patches: bool, fine: bool, images: Tensor) -> Tensor:
    """Return the features of images, followed by those of their patches and of their fine patches."""
    rows = []
    for batch in images.split(BATCH):
        if encoder.forward_patches is None or not patches:
            rows.append(encoder(batch))
            continue
        pooled, cells = encoder.forward_patches(batch)
        parts = [coarse(cells), cells] if fine else [coarse(cells)]
        rows.append(torch.cat([pooled, *(part.flatten(1).to(pooled) for part in parts)], 1))
    return torch.cat(rows)
