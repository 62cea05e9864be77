"""The frame of a recipe: one line at once, help without its imports, its options, where it may write, and its end."""

import argparse
import gc
import os
import sys
import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from dirl.config.schemas import ConfigError

SHOWING = {"-h", "--help", "-sc", "--shell-completion", "--hydra-help", "-c", "--cfg", "-i", "--info", "--version"}
"""Flags by which something is shown and nothing is run."""


def start(text: str | None, schema: type | Mapping[str, type] | None = None) -> Any:
    """Read the command line of a recipe, or answer a request for help.

    A recipe calls it before its other imports, which take seconds. Until `run` no garbage is collected: the imports
    make several hundred thousand objects that stay.

    Args:
        text: what it does, with examples, for ``--help``: the recipe's docstring.
        schema: the dataclass of its options, or of each of its commands by name; None for a training, whose options
            Hydra composes.

    Returns:
        The options; of a training None.

    Raises:
        SystemExit: help was asked for, or the command line is wrong.
    """
    from dirl.runs.exits import end_at_once, one_line_exits

    end_at_once(b"; nothing was written")
    shows = not SHOWING.isdisjoint(argument.partition("=")[0] for argument in sys.argv[1:])
    if not shows:
        print("loading ...", file=sys.stderr, flush=True)  # before anything that takes time
    # Threads of OpenMP that wait for each other spin, and beside other processes they wait for most of the time
    # (docs/performance.md). Read when torch is imported, also by the processes that this one starts.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    # Python 3.14 tries every help text when its option is declared, and one of Hydra 1.3.8 is no string.
    setattr(argparse._ActionsContainer, "_check_help", lambda parser, action: None)  # noqa: B010
    with one_line_exits(lambda: "nothing was written"):
        from dirl.cli import help, parsing
        from dirl.config.components import check_choice

        arguments = sys.argv[1:]
        if schema is not None and "-sc" in arguments:
            help.complete(schema)
        text = text or ""
        if isinstance(schema, Mapping):
            if not arguments or arguments[0] in ("-h", "--help"):
                help.show_commands(text, schema)
            command, *arguments = arguments
            check_choice(f"command '{command}'", command, schema)
            schema = schema[command]
            text = schema.__doc__ or ""
        if schema is None and any(argument.startswith("-") for argument in arguments):
            parsing.check_flags(arguments)
        if shows:
            help.show(text, schema, arguments)
        options = None if schema is None else parsing.parse(schema, arguments)
        if schema is None:
            sys.argv[1:] = parsing.prepare(arguments)
    gc.disable()
    return options


def run(main: Callable[[], object], options: object = None) -> None:
    """Run a recipe's function; a wrong input, an interrupt or an error of the machine ends it with one line.

    That of an interrupt says whether what ``options`` tell to write was written; a run tells it itself once it trains.

    Raises:
        SystemExit: see `dirl.runs.exits`.
    """
    from dirl.cli.parsing import one_line_errors
    from dirl.runs.exits import end_at_once, one_line_exits

    os.environ.setdefault("HYDRA_FULL_ERROR", "1")  # else Hydra tells errors in many lines
    gc.freeze()  # what the imports made is not looked through again
    gc.enable()
    end_at_once()  # from here on something may have been written
    with one_line_exits(lambda: unwritten(options)), one_line_errors():
        main()


def new_file(name: str, ending: str = ".h5") -> Path:
    """Return where to write; `ConfigError` for another ending, and where something is or nothing can be written."""
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
