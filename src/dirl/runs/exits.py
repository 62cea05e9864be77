"""How a program ends when the machine or the user stops it: one line, and an exit status for the reason.

The statuses are in docs/reliability.md. Anything else is a bug, and shows its traceback. This module imports nothing
slow, so that a recipe can use it before it imports torch.
"""

import contextlib
import errno
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, NoReturn

SIGNALS = (signal.SIGINT, signal.SIGTERM)
MEMORY, FILES, PIPE = 71, 74, 128 + 13
"""Exit statuses; the first two as in ``sysexits.h``."""

LONGEST = 2000
"""Characters of an error."""

HINTS = {
    errno.ENOSPC: "make room on the disk",
    errno.EDQUOT: "make room within the quota",
    errno.EFBIG: "raise the limit of a file's size (ulimit -f)",
    errno.EROFS: "choose a folder that can be written to",
    errno.EACCES: "choose a folder that can be written to",
    errno.EPERM: "choose a folder that can be written to",
    errno.ENOENT: "was it deleted or moved meanwhile, or can nothing be made there?",
    errno.EMFILE: "raise the limit of open files (ulimit -n)",
}
"""What to do about an error of the operating system."""


class Terminated(BaseException):
    """SIGTERM as an exception, as ``KeyboardInterrupt`` is for SIGINT."""


def end_at_once(advice: bytes = b"") -> None:
    """Let SIGINT and SIGTERM end the program with one line from now on, where no context of this module handles them.

    That is while a recipe imports torch, and after it has ended: there is nothing to save then. Python's own handlers
    would print a traceback, or nothing. The line ends with ``advice``.
    """
    for number, own in {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}.items():
        now = signal.getsignal(number)
        if (now is own or isinstance(now, EndAtOnce)) and threading.current_thread() is threading.main_thread():
            signal.signal(number, EndAtOnce(advice))


@dataclass(frozen=True)
class EndAtOnce:
    """A handler of signals, see `end_at_once`."""

    advice: bytes

    def __call__(self, number: int, _: object) -> NoReturn:
        """End the program."""
        os.write(2, (b"interrupted" if number == signal.SIGINT else b"terminated") + self.advice + b"\n")
        os._exit(128 + number)


@contextlib.contextmanager
def one_line_exits(advice: Callable[[], str] = lambda: "", folder: Path | None = None) -> Iterator[None]:
    """End the program with one line at an interrupt, a wrong input or an error of the machine within this context.

    Where the input is not to blame, ``advice`` says what is safe, and how to continue. The ``folder`` was made by Hydra
    beforehand; it is deleted again if nothing has been written there.

    Raises:
        SystemExit: with a status of the table above.
    """
    raised: list[BaseException] = []

    def raise_(number: int, _: object) -> NoReturn:
        raised.append(KeyboardInterrupt() if number == signal.SIGINT else Terminated())
        raise raised[-1]

    now = signal.getsignal(signal.SIGINT)
    own = now is signal.default_int_handler or isinstance(now, EndAtOnce)  # somebody else's handler of SIGINT stays
    try:
        with _signals(dict.fromkeys(SIGNALS if own else SIGNALS[1:], raise_)):
            try:
                yield
            except Exception:
                if raised:  # a library has turned the interrupt into an error of its own, as matplotlib's casts do
                    raise raised[0] from None
                raise
    except ValueError as error:
        _remove_empty(folder)
        # Without control characters, such as line breaks, and cut in the middle.
        said = "".join(sign if sign.isprintable() else " " for sign in " ".join(str(error).split()))
        said = said if len(said) <= LONGEST else f"{said[: LONGEST // 2]} ... {said[-LONGEST // 2 :]}"
        raise SystemExit(f"error: {said}") from None
    except KeyboardInterrupt:
        _remove_empty(folder)
        leave("interrupted", 128 + signal.SIGINT, advice)
    except Terminated:
        leave("terminated", 128 + signal.SIGTERM, advice)
    except BrokenPipeError:
        _silence(sys.stdout)
        leave("nobody reads any more what this program prints", PIPE, advice)
    except OSError as error:
        leave(f"error: {_told(error)}", FILES, advice)
    except Exception as error:
        if "shared memory(shm)" in str(error):
            leave("error: shared memory ran out; enlarge /dev/shm, or take fewer workers", MEMORY, advice)
        # torch raises a RuntimeError for it on the CPU.
        of_torch = isinstance(error, RuntimeError) and "DefaultCPUAllocator" in str(error)
        if not (isinstance(error, MemoryError) or type(error).__name__ == "OutOfMemoryError" or of_torch):
            raise
        leave("error: memory ran out; make the run smaller, or free some", MEMORY, advice)


def _remove_empty(folder: Path | None) -> None:
    """Delete a folder, and those above it, as far as they are empty."""
    if folder is not None:
        with contextlib.suppress(OSError):
            os.removedirs(folder)


def leave(message: str, status: int, advice: Callable[[], str] = lambda: "") -> NoReturn:
    """End the program with an exit status and one line on the standard error: what happened, and how to go on."""
    try:
        print("; ".join(filter(None, [message, advice()])), file=sys.stderr, flush=True)
    except BrokenPipeError:
        _silence(sys.stderr)
    raise SystemExit(status) from None


def _silence(stream: IO[str]) -> None:
    """Discard the buffer of a closed stream, or the interpreter would complain at its end."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _told(error: OSError) -> str:
    """Return an error of the operating system in one line: the file, the reason, what to do."""
    where = f"{error.filename}: " if error.filename else ""
    reason = error.strerror or (str(error).splitlines() or [type(error).__name__])[0]
    hint = HINTS.get(error.errno or 0, "")
    return f"{where}{reason}{f'; {hint}' if hint else ''}"


@contextlib.contextmanager
def _signals(handlers: dict[signal.Signals, Any]) -> Iterator[None]:
    """Handle signals within this context; only the main thread can; in others nothing changes."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def interruptible() -> Iterator[list[int]]:
    """Fill a list at the first SIGINT or SIGTERM within this context, so that a loop ends in a consistent state.

    The next one acts at once, as it would outside.

    Yields:
        The number of the signal, once there was one.
    """
    asked: list[int] = []
    before = {number: signal.getsignal(number) for number in SIGNALS}

    def note(number: int, _: object) -> None:
        asked.append(number)
        for each, handler in before.items():
            signal.signal(each, handler)

    with _signals(dict.fromkeys(SIGNALS, note)):
        yield asked
