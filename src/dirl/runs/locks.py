"""Locks of run folders: one run in a folder, and one process at a time that writes to it."""

import errno
import os
import platform
import re
import sys
import weakref
from contextlib import suppress
from itertools import chain, count
from pathlib import Path

from filelock import FileLock, Timeout

from dirl.runs.checkpoints import CONFIG_FILE, RunError

NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EINVAL)
"""What file systems answer that have no locks; those that do not know the call at all, ``filelock`` sees to."""

TIME = re.compile(r"\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d")
"""The name that a recipe gives a folder by itself: the second it began in. As nobody has chosen it, a run in such a
folder, or a job of a sweep in one, gets a number where the folder is another's."""


class RunningError(RunError):
    """A run folder that another process writes to."""


class FolderLock:
    """The lock of an existing run folder, held until `release` or until the process ends in whatever way.

    It is the operating system's (``flock``) on the file ``.lock``, so that a dead process holds none; the file itself
    means nothing, and is deleted at release. On a file system without ``flock`` the library uses the existence of the
    file instead, with a warning. Where locks are refused altogether (some network mounts) the run continues without one
    and says so in one line: do not resume a run there while it is running.

    Raises:
        RunningError: another process holds it; the message says which.
        OSError: the folder cannot be written to.
    """

    def __init__(self, folder: Path) -> None:
        file = folder / ".lock"
        lock = FileLock(str(file))
        try:
            lock.acquire(blocking=False)
        except Timeout:
            holder = "another process"
            with suppress(OSError, UnicodeDecodeError):
                holder = file.read_text(encoding="utf-8")[:100].strip() or holder
            raise RunningError(f"{folder}: {holder} is writing to it; wait for it, or stop it") from None
        except OSError as error:
            if error.errno not in NO_LOCKS:
                raise
            warning = f"{folder}: cannot be locked ({error.strerror}); do not resume this run while it runs"
            print(warning, file=sys.stderr, flush=True)
        else:
            with suppress(OSError):  # for people; nothing reads it but the message above
                file.write_text(f"process {os.getpid()} on {platform.node()}", encoding="utf-8")
        self.release = weakref.finalize(self, _release, lock, file, os.getpid())
        """To be called: releases the folder for other processes."""


def _release(lock: FileLock, file: Path, owner: int) -> None:
    if os.getpid() != owner or not lock.is_locked:  # a forked child holds nothing of its own
        return
    with suppress(OSError):  # the folder may be gone
        file.unlink()  # before the release: afterwards it could be another's
    with suppress(OSError):
        lock.release(force=True)


def claim(folder: Path) -> tuple[Path, FolderLock]:
    """Lock a folder for a new run, or, where a run gets a number (``<folder>-2``), the first of its name that is free.

    Raises:
        RunError: it holds a run, or another process writes to it.
        OSError: it cannot be made, or written to.
    """
    problem = RunError(f"{folder}: holds a run already; choose another folder")
    numbers = count(2) if any(map(TIME.fullmatch, folder.parts[-2:])) else ()
    for candidate in chain([folder], (folder.with_name(f"{folder.name}-{number}") for number in numbers)):
        candidate.mkdir(parents=True, exist_ok=True)
        try:
            lock = FolderLock(candidate)
        except RunningError as error:
            problem = error
            continue
        if not (candidate / CONFIG_FILE).exists():
            return candidate, lock
        lock.release()
    raise problem
