"""Values of options: checked against their types and bounds, and told in words."""

import difflib
import inspect
import math
import types
import typing
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from enum import Enum
from typing import Any, Literal, get_args, get_origin, get_type_hints

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from dirl.config.bounds import Bounds
from dirl.config.schemas import ConfigError

PLAIN = {int: "a whole number", float: "a number", bool: "true or false", str: "text", types.NoneType: "null"}


def option_types(schema: type, prefix: str = "", *, bounds: bool = False) -> dict[str, Any]:
    """The types of all options of a configuration, by their dotted names; with ``bounds`` as they are annotated."""
    found: dict[str, Any] = {}
    for name, kind in get_type_hints(schema, include_extras=bounds).items():
        found[prefix + name] = kind
        if is_dataclass(kind):
            found |= option_types(kind, f"{prefix}{name}.", bounds=bounds)  # type: ignore[arg-type]
    return found


def typed(config: DictConfig) -> Any:
    """The dataclass of a composed configuration.

    Raises:
        ConfigError: a value is missing, of the wrong type, or outside its limits.
    """
    try:
        made = OmegaConf.to_object(config)
        for name, value in config.items():
            if isinstance(value, DictConfig) and OmegaConf.get_type(value) is dict:  # plain, also what is interpolated
                setattr(made, str(name), OmegaConf.to_container(value, resolve=True, enum_to_str=True))
    except OmegaConfBaseException as error:
        raise ConfigError(f"{error.full_key or 'an option'}: {str(error).splitlines()[0]}") from None
    scene = OmegaConf.select(config, "scene")
    for one in scene if OmegaConf.is_list(scene) else [scene]:
        if one is not None and not isinstance(one, str):
            raise ConfigError(f"scene={scene}: must be a name, a path, or a list of them")
    for name, kind in option_types(type(made), bounds=True).items():
        check_bounds(name, OmegaConf.select(config, name), kind)
    for name, value in leaves(OmegaConf.to_container(config, resolve=True)).items():
        check_finite(name, value)
    return made


def check_choice(told: str, given: str, choices: Collection[str], prefix: str = "") -> None:
    """Raise `ConfigError` unless there is such a choice; ``told`` is what there is not."""
    if given not in choices:
        near = difflib.get_close_matches(given, choices, n=1)
        hint = f"did you mean {prefix}{near[0]}?" if near else f"choose from {', '.join(choices) or 'none'}"
        raise ConfigError(f"there is no {told}; {hint}")


def plain(config: Any) -> dict[str, Any]:
    """The values of a typed configuration, nested; without what it was started with (``resume``, ``trust``)."""
    values: Any = OmegaConf.to_container(OmegaConf.structured(config), resolve=True, enum_to_str=True)
    return {**values, "resume": None, "trust": None}


def leaves(config: Any, prefix: str = "") -> dict[str, Any]:
    """The values of a nested configuration by dotted name; goals and lists are values."""
    found: dict[str, Any] = {}
    for name, value in config.items():
        inside = isinstance(value, Mapping) and name != "goals"
        found |= leaves(value, f"{prefix}{name}.") if inside else {f"{prefix}{name}": value}
    return found


def check_value(name: str, value: Any, annotation: Any) -> None:
    """Check one value against an annotation; annotations of other than plain values are not checked.

    Raises:
        ConfigError: it does not fit.
    """
    check_finite(name, value)
    check_bounds(name, value, annotation)
    if not fits(value, annotation):
        raise ConfigError(f"{name}={'null' if value is None else value}: must be {in_words(annotation)}")


def check_finite(name: str, value: Any) -> None:
    """Raise `ConfigError` for a number that is infinite or none."""
    if isinstance(value, float) and not math.isfinite(value):
        raise ConfigError(f"{name}={value}: must be a finite number")


def check_bounds(name: str, value: Any, annotation: Any) -> None:
    """Raise `ConfigError` for a number outside the bounds of an annotation."""
    for bounds in _bounds(annotation):
        if type(value) in (int, float) and value not in bounds:
            raise ConfigError(f"{name}={value}: must be {bounds}")


def _bounds(annotation: Any) -> Iterator[Bounds]:
    for inside in get_args(annotation):
        if isinstance(inside, Bounds):
            yield inside
        yield from _bounds(inside)


def fits(value: Any, kind: Any) -> bool:
    """Whether a value is of the type that an annotation names, and within its bounds."""
    origin, inside = get_origin(kind), get_args(kind)
    if origin is typing.Annotated:
        return fits(value, inside[0]) and all(value in bounds for bounds in _bounds(kind))
    if origin in (types.UnionType, typing.Union):
        return any(fits(value, one) for one in inside)
    if origin is Literal:
        return value in inside
    if origin is list:
        return isinstance(value, list) and all(fits(one, inside[0]) for one in value)
    if origin is dict:
        return isinstance(value, dict) and all(fits(k, inside[0]) and fits(v, inside[1]) for k, v in value.items())
    if inspect.isclass(kind) and issubclass(kind, Enum):
        return value in list(kind)
    if kind is float:
        return isinstance(value, int | float) and not isinstance(value, bool)
    if kind in PLAIN:
        return isinstance(value, kind) and not (kind is int and isinstance(value, bool))
    if kind is not Any and inspect.isclass(kind) and not issubclass(kind, Sequence | Mapping):
        return isinstance(value, kind)  # a tensor, a module: no option can hold one
    return True


def in_words(kind: Any) -> str:
    """A type in words, for errors."""
    if get_origin(kind) is typing.Annotated:
        return in_words(get_args(kind)[0])
    if get_origin(kind) in (types.UnionType, typing.Union):
        told = [one for one in get_args(kind) if one in PLAIN or get_args(one) or issubclass(one, Enum)]
        return " or ".join(in_words(one) for one in told)
    if get_origin(kind) is Literal:
        return f"one of {', '.join(map(str, get_args(kind)))}"
    if get_origin(kind) is list:
        (each,) = get_args(kind)
        return "a list" if each is Any else f"a list, each {in_words(each)}"
    if inspect.isclass(kind) and issubclass(kind, Enum):
        return f"one of {', '.join(kind)}"
    return PLAIN.get(kind, getattr(kind, "__name__", str(kind)))
