"""Checks of a room description: known keys, and values of the types that functions are annotated with."""

import difflib
import inspect
import math
import types
from collections.abc import Callable, Collection, Mapping
from typing import Any, Union, get_args, get_origin

from dirl.scenes.scene import SceneError

NAMES = {float: "a number", int: "a whole number", bool: "true or false", str: "text", dict: "a table", list: "a list"}


def functions_of(*modules: types.ModuleType) -> dict[str, Callable[..., Any]]:
    """The public functions that modules define, by their names, in the order of their definitions."""
    return {
        name: made
        for module in modules
        for name, made in vars(module).items()
        if inspect.isfunction(made) and made.__module__ == module.__name__ and not name.startswith("_")
    }


def check_keys(table: Mapping[str, Any], known: Collection[str], where: str, *, required: Collection[str] = ()) -> None:
    """Raise `SceneError` unless every key is known and none that is required is missing."""
    for key in table:
        if key not in known:
            near = difflib.get_close_matches(key, known, n=1)
            hint = f"did you mean '{near[0]}'?" if near else f"choose from {', '.join(known)}"
            raise SceneError(f"{where}: there is no '{key}'; {hint}")
    for key in required:
        if key not in table:
            raise SceneError(f"{where}: '{key}' is missing")


def check_value(value: Any, kind: Any, where: str) -> Any:
    """A value from a TOML file as a type: lists become tuples, integers become floats where floats are expected."""
    made = _as(value, kind)
    if made is None:
        raise SceneError(f"{where}: expected {_named(kind)}, found {value!r}")
    return made


def _as(value: Any, kind: Any) -> Any:
    """None if the value is not of that type; no TOML value is None."""
    origin, inner = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        return next((made for part in inner if part is not type(None) and (made := _as(value, part)) is not None), None)
    if origin is tuple:
        if not isinstance(value, list | tuple):
            return None
        kinds = [inner[0]] * len(value) if inner[-1] is Ellipsis else inner
        made = [_as(item, part) for item, part in zip(value, kinds, strict=False)]
        return None if len(value) != len(kinds) or any(item is None for item in made) else tuple(made)
    if kind is float:
        number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        return float(value) if number else None
    if kind is int and isinstance(value, bool):
        return None
    return value if isinstance(value, kind) else None


def _named(kind: Any) -> str:
    origin, inner = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        return " or ".join(_named(part) for part in inner if part is not type(None))
    if origin is tuple:
        if inner[-1] is Ellipsis:
            return f"a list, each {_named(inner[0])}"
        return f"[{', '.join(_named(part) for part in inner)}]"
    return NAMES[kind]
