"""Trials of components: what is wrong with one's own is said in one line, before a training begins."""

import inspect
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from dirl.config.schemas import ConfigError

CODE = (ArithmeticError, AssertionError, AttributeError, LookupError, NameError, RuntimeError, TypeError, ValueError)
"""What the code of a component raises; errors of the machine are others."""


@contextmanager
def tried(name: str, made: object, how: str = "") -> Iterator[None]:
    """Within this context an error of a component is told in one line.

    Args:
        name: of the component, ``losses.a2c``.
        made: the component.
        how: it is called, for the error.

    Raises:
        ConfigError: the component, or a check of what it gave, raised one of `CODE`.
    """
    try:
        yield
    except ConfigError:
        raise
    except CODE as error:
        raise ConfigError(f"{name}: cannot be called as it should{how}: {describe_error(error, type(made))}") from None


def describe_error(error: Exception, cls: type) -> str:
    """Return what a class's code raised, in one line with the place in its own file, as no traceback shows it."""
    says = " ".join(str(error.args[0] if isinstance(error, KeyError) and error.args else error).split())
    if not says or not isinstance(error, RuntimeError | ValueError):  # which say what is wrong by themselves
        says = f"{type(error).__name__}: {says}" if says else type(error).__name__
    try:
        file = inspect.getsourcefile(cls)
    except (OSError, TypeError):  # a class of an interactive session
        file = None
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    return f"{says} ({Path(file).name}, line {lines[-1]})" if file and lines else says
