"""Calls of the operating system that fail when they are told to: the n-th of all, or of one kind.

Python's own calls are wrapped, so that what a library written in C writes by itself is not counted; a run writes all
its files through Python. Calls below a folder count, and those on a descriptor of a file there.
"""

import atexit
import builtins
import errno
import io
import json
import os
from pathlib import Path

KINDS = {
    "open": errno.EROFS,
    "write": errno.ENOSPC,
    "fsync": errno.EIO,
    "rename": errno.EDQUOT,
    "mkdir": errno.EACCES,
    "truncate": errno.EIO,
    "remove": errno.EROFS,
}
"""What can fail, and how."""


class Faults:
    """Counts the calls below a folder by their kind, and lets one of them fail.

    Args:
        folder: calls elsewhere are left alone.
        kind: of the call that fails, see `KINDS`.
        number: which of them fails, from 1; 0 lets none fail.
        lasting: all of its kind after it fail too, as on a full disk.
    """

    def __init__(self, folder, kind="open", number=0, lasting=False):
        self.folder = os.path.realpath(folder)
        self.kind, self.number, self.lasting = kind, number, lasting
        self.counts = dict.fromkeys(KINDS, 0)

    def call(self, kind, path):
        """Count a call; raise `OSError` if it is its turn."""
        if not self._inside(path):
            return
        self.counts[kind] += 1
        if kind != self.kind or not self.number:
            return
        count = self.counts[kind]
        if count == self.number or (self.lasting and count > self.number):
            raise OSError(KINDS[kind], os.strerror(KINDS[kind]), None if kind in ("write", "fsync") else str(path))

    def _inside(self, path):
        if isinstance(path, int):
            path = f"/proc/self/fd/{path}"
        return os.path.realpath(path).startswith(self.folder)

    def install(self, report=None):
        """Wrap the calls in this process for good; write the counts into a file at its end, if one is named."""
        for kind, names in {
            "fsync": ["fsync"],
            "rename": ["rename", "replace"],
            "mkdir": ["mkdir"],
            "truncate": ["truncate", "ftruncate"],
            "remove": ["unlink", "remove", "rmdir"],
        }.items():
            for name in names:
                setattr(os, name, self._wrapped(kind, getattr(os, name)))
        faults, plain_open = self, io.open

        class Raw(io.FileIO):
            def write(self, data):
                faults.call("write", self.fileno())
                return super().write(data)

        def opened(file, mode="r", buffering=-1, encoding=None, errors=None, newline=None, closefd=True, opener=None):
            writes = set(mode) & set("wax+") and not isinstance(file, int) and faults._inside(file)
            if not writes or opener is not None:
                return plain_open(file, mode, buffering, encoding, errors, newline, closefd, opener)
            faults.call("open", file)
            raw = Raw(os.fspath(file), mode.replace("b", "").replace("t", ""))
            buffered = io.BufferedRandom(raw) if "+" in mode else io.BufferedWriter(raw)
            return buffered if "b" in mode else io.TextIOWrapper(buffered, encoding or "utf-8", errors, newline)

        io.open = builtins.open = opened
        if report is not None:
            atexit.register(lambda: Path(report).write_text(json.dumps(self.counts)))

    def _wrapped(self, kind, function):
        def wrapper(path, *arguments, **options):
            if options.get("dir_fd") is not None:
                self.call(kind, Path(f"/proc/self/fd/{options['dir_fd']}") / path)
            else:
                self.call(kind, path)
            return function(path, *arguments, **options)

        return wrapper
