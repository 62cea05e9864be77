"""Valid contents of a checkpoint."""

import math
from pathlib import Path
from typing import Annotated, Any, Literal, NotRequired, get_args

import torch
from annotated_types import MinLen
from pydantic import ConfigDict, TypeAdapter, ValidationError, with_config
from torch import Tensor
from typing_extensions import TypedDict

from dirl.config.bounds import Bounds
from dirl.config.values import first_error
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


@with_config(ConfigDict(strict=True, arbitrary_types_allowed=True))
class Header(TypedDict):
    """What checkpoints hold; `dirl.runs.states` compares the state of a training, if it is there, with a fresh one."""

    network: dict[str, Tensor]
    config: str
    extractor: str
    scenes: Annotated[list[str], MinLen(1)]
    frames: Count
    schema: NotRequired[Count]
    views: NotRequired[Annotated[list[str], MinLen(1)]]
    turns: NotRequired[Annotated[list[Count], MinLen(1)]]
    learning: NotRequired[dict[str, Tensor]]
    tables: NotRequired[dict[Table, Count]]
    seconds: NotRequired[Duration]
    training_seconds: NotRequired[Duration]


def check_header(state: Any, file: Path) -> dict[str, Any]:
    """The content of a checkpoint file, or `RunError` if it is not a `Header`, or one of a newer version."""
    if isinstance(state, dict) and type(state.get("schema")) is int and state["schema"] > SCHEMA:
        raise RunError(
            f"{file}: was written by a newer version of dirl (schema {state['schema']}); update dirl to use it"
        )
    try:
        TypeAdapter(Header).validate_python(state)
    except ValidationError as error:
        raise RunError(f"{file}: is no checkpoint of dirl: {first_error(error)}") from None
    return state
