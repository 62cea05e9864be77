"""Files and folders that a command is to write: refused before its work where they cannot be."""

import os
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

from dirl.config.schemas import ConfigError


def new_file(name: str, ending: str = ".h5") -> Path:
    """Return where to write.

    Raises:
        ConfigError: it has another ending, is there already, or nothing can be written there.
    """
    path = Path(name)
    if ending and path.suffix != ending:
        raise ConfigError(f"out={name}: the name must end in {ending}")
    if os.path.exists(name):  # of a name that is too long a Path would raise
        raise ConfigError(f"out={name}: this file exists already; it is not overwritten")
    check_writable(name)
    return path


def check_writable(name: str) -> None:
    """Raise `ConfigError` for what cannot be made, and for a folder in which nothing can be."""
    path = Path(name).absolute()
    try:
        with suppress(FileNotFoundError, NotADirectoryError):
            path.lstat()  # a name that is too long is told here; from Python 3.14 on the methods of Path hide it
        above = path if path.is_dir() else next(folder for folder in path.parents if folder.exists())
        with tempfile.TemporaryFile(dir=above):
            pass
    except OSError as error:
        raise ConfigError(f"out={name}: cannot be written ({error.strerror})") from None


def unwritten(options: object) -> str:
    """Return what an interrupted command has left of its ``out``, for the last line; None are those of a training."""
    if options is None:  # of a sweep, some runs may be finished
        return "" if {"-m", "--multirun"} & set(sys.argv) else "nothing was trained"
    out = getattr(options, "out", None)
    if out is None or not os.path.exists(out):
        return "nothing was written"
    return f"{out} holds what was finished before" if os.path.isdir(out) else f"{out} was written"
