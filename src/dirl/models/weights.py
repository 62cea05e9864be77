"""The weights of a checkpoint, for a policy."""

import sys
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from torch import Tensor, nn

from dirl.config.schemas import ConfigError


def check_extractor(saved: Mapping[str, Any], extractor: str, origin: str) -> None:
    """Compare the extractor of a scene's features, or of a navigator's encoder, with that of a checkpoint's training.

    Raises:
        ConfigError: they differ.
    """
    if extractor != saved["extractor"]:
        raise ConfigError(
            f"{origin}: was trained on features of another extractor: '{saved['extractor']}', not '{extractor}'"
        )


def turns_of_training(saved: Mapping[str, Any]) -> set[int]:
    """How many turns made a full circle in the scenes of a checkpoint's training; 4 where it does not say."""
    return set(saved.get("turns", [4]))


def tell_of_turns(trained: Collection[int], found: Collection[int], origin: str) -> None:
    """Tell in one line on the terminal if a policy is used with numbers of turns that it was not trained with."""
    if strange := set(found) - set(trained):
        known, new = (" and ".join(f"{360 / turns:g}" for turns in sorted(some)) for some in (trained, strange))
        print(
            f"warning: {origin}: was trained with turns of {known} degrees; with turns of {new} degrees its paths may "
            "be much longer (checkpoint=general was trained with 90, 45 and 30)",
            file=sys.stderr,
            flush=True,
        )


def load_weights(policy: nn.Module, weights: Mapping[str, Tensor], origin: str, scenes: Sequence[str] = ()) -> None:
    """Load a checkpoint's weights; if ``scenes`` are given, only those of their heads.

    Raises:
        ConfigError: they do not fit.
    """
    own = {name.replace(".", "_") for name in scenes} | {"shared"}
    try:
        found = {
            name: value
            for name, value in weights.items()
            if not scenes or ".scenes." not in name or name.split(".scenes.")[1].split(".")[0] in own
        }
        policy.load_state_dict(found)
    except (RuntimeError, KeyError, AttributeError) as error:
        reason = " ".join(str(error).split())[:300]
        raise ConfigError(f"{origin}: the weights do not fit the network of its configuration ({reason})") from None
