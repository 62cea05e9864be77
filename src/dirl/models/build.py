"""The policy of a configuration: its features, encoder, memory and heads; and the weights of a checkpoint for it."""

import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn

from dirl.config.components import TARGET, class_parameters, find_class, make, tried
from dirl.config.schemas import ConfigError, TrainConfig
from dirl.envs.transforms import VIEWS
from dirl.models import (
    ActorCritic,
    FeatureTable,
    ObservationTable,
    feature_statistics,
    initial_state,
    recurrent_keys,
    whitening,
)
from dirl.perception.backbones.patches import PATCH_SHAPE, coarse
from dirl.perception.recognition.recogniser import NCC
from dirl.scenes import ACTIONS
from dirl.scenes.world import World


def build_policy(
    config: TrainConfig,
    features: FeatureTable,
    scenes: Collection[str],
    *,
    world: World | None = None,
    views: int = VIEWS,
) -> ActorCritic:
    """Return the policy with its initial weights, which depend on the seed alone.

    A policy that is loaded outside of its scenes has no world. ``views`` is how many an observation has.

    Raises:
        ConfigError: components that do not fit together.
    """
    trust = config.trust
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.seed)
        # Patches have one shape wherever they are computed, see dirl.perception.backbones.patches.
        read = {"num_features": features.table.shape[1], "num_views": views, "patch_shape": PATCH_SHAPE}
        encoder: Any = make("encoder", config.encoder, trust, **read)
        if isinstance(features, ObservationTable):
            # The encoder reads coordinates, with the weights that it would begin with on features.
            weights = encoder.state_dict()
            for layer in encoder.linear:
                name = f"{layer}.weight"
                weights[name] = features.narrow(weights[name].to(features.table.device))
            with torch.random.fork_rng(devices=[]):
                read |= {"num_features": features.width, "num_views": features.slots}
                encoder = make("encoder", config.encoder, trust, **read)
            encoder.load_state_dict(weights)
        shape = [1, features.slots if isinstance(features, ObservationTable) else views, features.width]
        fused = _output_width("encoder", encoder, lambda: encoder(*torch.zeros(2, *shape)), shape)
        memory = make("memory", config.memory, trust, input_size=fused, in_key="fused", out_key="memory")
        encoded = fused
        if memory is not None:
            encoded = _output_width("memory", memory, lambda: _remember(memory, fused), [1, fused])
        heads = make("heads", config.heads, trust, scenes=list(scenes), in_features=encoded, num_actions=len(ACTIONS))
        parts = {"encoder": encoder, "memory": memory, "heads": heads, "features": features, "world": world}
        policy: ActorCritic = make("policy", config.policy, trust, **parts)
        return policy.to(features.table.device)


def _output_width(name: str, component: object, call: Callable[[], object], shape: list[int]) -> int:
    """Return the width of what a component gives for one row."""
    with tried(name, component, f", on features {shape}"), torch.no_grad():
        result = call()
    if not isinstance(result, Tensor) or result.ndim != 2 or len(result) != 1:
        given = list(result.shape) if isinstance(result, Tensor) else type(result).__name__
        raise ConfigError(f"{name}: gives {given} for one row; expected [1, width]")
    return result.shape[1]


def _remember(memory: TensorDictModuleBase, width: int) -> Tensor:
    """Return what a memory makes of one row."""
    if not recurrent_keys(memory):
        raise ValueError('writes no recurrent state, ("next", ...) among its out_keys')
    begins = {"is_init": torch.ones(1, 1, dtype=torch.bool), **initial_state(memory, 1, torch.device("cpu"))}
    return memory(TensorDict({"fused": torch.zeros(1, width), **begins}, batch_size=[1]))["memory"]


def feature_table(
    config: TrainConfig, world: World, weights: Mapping[str, Tensor] | None = None, origin: str = "init", room: int = 0
) -> FeatureTable:
    """Return the features of the world's states, standardised or whitened as configured.

    If weights of a trained network are given, its mean, standard deviation and axes are used, not the world's. There is
    ``room`` for so many views that are encoded later, see `FeatureTable.write`.

    Raises:
        ConfigError: the encoder reads patches, and the scenes have none.
    """
    mean, std, axes = None, None, None
    if weights is not None:
        mean, std, axes = saved_statistics(weights)
        if mean is not None and len(mean) != world.features.shape[1]:
            raise ConfigError(
                f"{origin}: the weights read {len(mean)} features; these scenes have {world.features.shape[1]}"
            )
    elif config.network.components:
        mean, std, axes = whitening(world.features, config.network.components)
    elif config.network.standardise:
        mean, std = feature_statistics(world.features)
    patches = None
    if reads_patches(config):
        if world.patches is None:
            raise ConfigError(
                f"encoder={config.encoder[TARGET]} compares patches, and {world.names[0]} has none; encode it again by "
                "scenes.py encode ... patches=true"
            )
        patches = coarse(world.patches)
    return FeatureTable(world.features, mean, std, axes, patches, room).to(world.device)


def saved_statistics(weights: Mapping[str, Tensor]) -> tuple[Tensor | None, Tensor | None, Tensor | None]:
    """Return mean, standard deviation and axes of the features that a network was trained on, float32.

    The agents of the package are stored as float16, half the size.
    """
    keys = [f"features.{name}" for name in ("mean", "std", "axes")]
    mean, std, axes = (weights[key].float() if key in weights else None for key in keys)
    return mean, std, axes


def reads_patches(config: TrainConfig) -> bool:
    """Return True if the encoder compares patches: its constructor takes ``patch_shape``."""
    return "patch_shape" in class_parameters(find_class("encoder", config.encoder[TARGET], config.trust))


def pixels_read(config: TrainConfig) -> int | None:
    """Return to what width views are reduced, see ``network.pixels``; None where correlation compares their details."""
    recogniser = find_class("recogniser", config.recogniser[TARGET], config.trust)
    return None if issubclass(recogniser, NCC) else config.network.pixels


def check_extractor(saved: Mapping[str, object], extractor: str, origin: str) -> None:
    """Compare the extractor of a scene's features, or of a navigator's encoder, with that of a checkpoint's training.

    Raises:
        ConfigError: they differ.
    """
    if extractor != saved["extractor"]:
        raise ConfigError(
            f"{origin}: was trained on features of another extractor: '{saved['extractor']}', not '{extractor}'"
        )


def turns_of_training(saved: Mapping[str, Any]) -> set[int]:
    """Return how many turns made a full circle in the scenes of a checkpoint's training; 4 where it does not say."""
    return set(saved.get("turns", [4]))


def tell_of_turns(trained: Collection[int], used: Collection[int], origin: str) -> None:
    """Tell in one line on the terminal if a policy is used with numbers of turns that it was not trained with."""
    if strange := set(used) - set(trained):
        known, new = (" and ".join(f"{360 / turns:g}" for turns in sorted(some)) for some in (trained, strange))
        print(
            f"warning: {origin}: was trained with turns of {known} degrees; with turns of {new} degrees its paths may "
            "be much longer (checkpoint=general was trained with 90, 45 and 30)",
            file=sys.stderr,
            flush=True,
        )


def load_weights(policy: nn.Module, weights: Mapping[str, Tensor], origin: str, scenes: Sequence[str]) -> None:
    """Load a checkpoint's weights, of ``scenes`` that are given only their heads; `ConfigError` if they do not fit."""
    heads = {name.replace(".", "_") for name in scenes} | {"shared"}
    try:
        chosen = {
            name: value
            for name, value in weights.items()
            if not scenes or ".scenes." not in name or name.split(".scenes.")[1].split(".")[0] in heads
        }
        policy.load_state_dict(chosen)
    except (RuntimeError, KeyError, AttributeError) as error:
        reason = " ".join(str(error).split())[:300]
        raise ConfigError(f"{origin}: the weights do not fit the network of its configuration ({reason})") from None
