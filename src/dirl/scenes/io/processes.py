"""Work that is shared among processes."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from typing import TypeVar

from dirl.scenes.scene import SceneError

Result = TypeVar("Result")


def in_processes(tasks: Sequence[Callable[[], Result]], processes: int, name: str) -> Iterator[Result]:
    """The results of tasks in the order in which they end; each process has one thread.

    After an error, or when no more results are wanted, tasks that have not begun are dropped.

    Args:
        tasks: without arguments; they and their results are pickled.
        processes: how many, as new interpreters.
        name: of a process in the error, such as ``rooms: a process that made a room``.

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
