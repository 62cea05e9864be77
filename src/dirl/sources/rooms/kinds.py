"""Kinds of furniture and of textures: functions by name."""

import inspect
import types
from collections.abc import Callable
from typing import Any


def functions_of(*modules: types.ModuleType) -> dict[str, Callable[..., Any]]:
    """Return the public functions that modules define, by their names, in the order of their definitions."""
    return {
        name: made
        for module in modules
        for name, made in vars(module).items()
        if inspect.isfunction(made) and made.__module__ == module.__name__ and not name.startswith("_")
    }
