"""Valid contents of a checkpoint."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import torch
from torch import Tensor

from dirl.config.bounds import Bounds
from dirl.config.values import fits
from dirl.runs.finding import SCHEMA, RunError

Count = Annotated[int, Bounds(0, 2**63 - 1)]
Duration = Annotated[float, Bounds(0, 10**10)]
Table = Literal["dagger.csv", "evaluation.csv", "imitation.csv", "reinforcement.csv"]

TABLES: tuple[str, ...] = get_args(Table)
"""What a training writes rows to; other files of its folder are left alone."""


def check_plain(state: Any, file: Path, limit: int) -> None:
    """Raise `RunError` unless everything is made of dictionaries, lists, texts, numbers and ordinary, finite tensors.

    An object with several references is checked once, so that the time is linear in the size of the file. All tensors
    may have ``limit`` bytes: more than the file, because some share their memory.
    """
    waiting: list[tuple[str, Any]] = [("", state)]
    seen: set[int] = set()
    while waiting:
        where, value = waiting.pop()
        if id(value) in seen:
            continue
        if isinstance(value, Tensor):
            seen.add(id(value))
            limit -= value.numel() * value.element_size()
            if limit < 0:
                raise RunError(f"{file}: holds tensors that are much larger than the file")
            _check_tensor(value, f"{file}: {where}")
        elif isinstance(value, dict):
            seen.add(id(value))
            if not all(type(key) in (str, int) for key in value):
                raise RunError(f"{file}: {where or 'it'} has keys that are neither text nor whole numbers")
            waiting += [(f"{where}.{key}".lstrip(".")[:200], inner) for key, inner in value.items()]
        elif isinstance(value, list | tuple):
            seen.add(id(value))
            waiting += [(f"{where}[{index}]"[:200], inner) for index, inner in enumerate(value)]
        elif not isinstance(value, str | bool | int | float | None):
            raise RunError(f"{file}: {where or 'it'} is a {type(value).__name__}, which no checkpoint holds")
        elif isinstance(value, float) and not math.isfinite(value):
            raise RunError(f"{file}: {where} is {value}; expected a finite number")


def _check_tensor(value: Tensor, where: str) -> None:
    if value.layout != torch.strided or value.device.type != "cpu" or value.is_quantized or value.is_complex():
        raise RunError(f"{where}: expected an ordinary tensor of real numbers, found {value.dtype} {value.layout}")
    # A stride of 0 makes a tensor of any size from one number.
    if value.numel() * value.element_size() > value.untyped_storage().nbytes():
        raise RunError(f"{where}: is a tensor of {list(value.shape)}, of which the file holds only a part")
    # Faster than checking each value; NaN propagates through minimum and maximum.
    if value.is_floating_point() and value.numel() and not torch.stack(value.aminmax()).isfinite().all():
        raise RunError(f"{where}: holds values that are not finite")


REQUIRED: Mapping[str, Any] = {
    "network": dict[str, Tensor],
    "config": str,
    "extractor": str,
    "scenes": list[str],
    "frames": Count,
}
"""What every checkpoint holds, and of what type."""

OPTIONAL: Mapping[str, Any] = {
    "schema": Count,
    "views": list[str],
    "turns": list[Count],
    "learning": dict[str, Tensor],
    "tables": dict[Table, Count],
    "seconds": Duration,
    "training_seconds": Duration,
}
"""What some hold; `dirl.runs.states` compares the state of a training with a fresh one."""


def check_header(state: Any, file: Path) -> dict[str, Any]:
    """The content of a checkpoint file, or `RunError` if it lacks what all hold or has it of another kind."""
    if not isinstance(state, dict):
        raise RunError(f"{file}: is no checkpoint of dirl; it holds a {type(state).__name__}")
    missing = sorted(REQUIRED.keys() - state.keys())
    if missing:
        raise RunError(f"{file}: is no checkpoint of dirl; it lacks {', '.join(missing)}")
    if fits(state.get("schema"), Count) and state["schema"] > SCHEMA:
        raise RunError(
            f"{file}: was written by a newer version of dirl (schema {state['schema']}); update dirl to use it"
        )
    for name, kind in {**REQUIRED, **OPTIONAL}.items():
        if name in state and (state[name] == [] or not fits(state[name], kind)):
            raise RunError(f"{file}: {name} is not what a checkpoint holds")
    return state
