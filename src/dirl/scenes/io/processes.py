"""Work that is shared among processes, and processes that end with this one."""

import os
import secrets
import subprocess
import weakref
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context, parent_process
from pathlib import Path
from threading import Thread
from typing import Any, TypeVar

from dirl.scenes.scene import SceneError

Result = TypeVar("Result")

WATCH = r"""
read -r _ || sleep 1  # a Doom that is just being started has no name yet
for arguments in /proc/[0-9]*/cmdline; do
  if grep -qs -e "$0" "$arguments"; then
    name=$(tr '\0' '\n' < "$arguments" | sed -n '/^+viz_instance_id$/{n;p;}')
    process=${arguments%/cmdline}
    if [ -n "$name" ]; then kill -9 "${process#/proc/}"; rm -f "/dev/shm/ViZDoom"*"$name"; fi
  fi
done
"""
"""Of a shell: wait for the end of its input, then end the Doom that has a word among its arguments, and remove what it
shared."""


def in_processes(tasks: Sequence[Callable[[], Result]], processes: int, name: str) -> Iterator[Result]:
    """Yield the results of tasks in the order in which they end; each process has one thread.

    After an error, or when no more results are wanted, tasks that have not begun are dropped. Processes are new
    interpreters; tasks and results are pickled. In the error a process has the ``name``, such as ``rooms: a process
    that made a room``.

    Raises:
        SceneError: a process was killed. Errors of tasks are raised as they are.
    """
    pool = ProcessPoolExecutor(processes, get_context("spawn"), _start)
    try:
        for done in as_completed([pool.submit(task) for task in tasks]):
            yield done.result()
    except BrokenProcessPool:
        raise SceneError(
            f"{name} was killed, perhaps because memory ran out; the same command "
            f"continues; if it happens again, give workers={max(1, processes // 2)}"
        ) from None
    finally:
        pool.shutdown(cancel_futures=True)


def _start() -> None:
    import torch

    torch.set_num_threads(1)  # each process has one core
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """End a process of a pool whose owner was killed: it would wait for work for ever."""
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def end_with_this_process(owner: object, game: Any) -> None:
    """Let a game of Doom end with its owner and with this process, even if that is killed: it would wait for ever.

    This is called before it starts, which takes a second.
    """
    if not Path("/proc").is_dir():  # elsewhere than on Linux a killed program leaves its Doom behind
        return
    word = f"-dirl{secrets.token_hex(8)}"
    game.add_game_args(word)  # which Doom ignores
    watch = subprocess.Popen(["sh", "-c", WATCH, word], stdin=subprocess.PIPE, start_new_session=True)
    weakref.finalize(owner, _close, game, watch)


def _close(game: Any, watch: subprocess.Popen[bytes]) -> None:
    game.close()
    watch.communicate(b"\n")
