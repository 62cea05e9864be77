"""The program that reads dumps of unknown origin, started by `dirl.scenes.io.isolation` and never imported.

It reads one request from its standard input and answers on its standard output. Each answer is a line of JSON and the
arrays that it lists.
"""

import json
import math
import os
import sys
import types
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

Answer = tuple[dict[str, Any], list[Any]]
"""What becomes JSON, and arrays."""


def main() -> None:
    """Answer the request."""
    _skip_the_packages()
    from dirl.scenes.scene import SceneError

    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a library prints must not come between the answers
    request = json.loads(sys.stdin.buffer.read())
    _limit("RLIMIT_AS", request["memory"])
    for task in request["tasks"]:
        _limit("RLIMIT_CPU", task.pop("seconds") + sum(os.times()[:2]))
        try:
            _answer(answers, *TASKS[task.pop("task")](**task))
        except (SceneError, OSError, MemoryError) as error:
            reason = str(error) if isinstance(error, SceneError) else f"{type(error).__name__}: {error}"
            _answer(answers, {"error": reason}, [])


def _skip_the_packages() -> None:
    """Make dirl's modules importable without the imports of their packages: torch alone would take seconds."""
    root = Path(__file__).parents[2]
    for name in ("dirl", "dirl.scenes", "dirl.scenes.io"):
        package = sys.modules[name] = types.ModuleType(name)
        package.__path__ = [str(root.joinpath(*name.split(".")[1:]))]


def _limit(what: str, value: float) -> None:
    """Limit this process, where the operating system can (Windows cannot, macOS only the time)."""
    with suppress(ImportError, ValueError, OSError):
        import resource

        limit = getattr(resource, what)
        hard = resource.getrlimit(limit)[1]
        soft = math.ceil(value)
        resource.setrlimit(limit, (soft if hard < 0 else min(soft, hard), hard))


def _read(path: str) -> Answer:
    from dirl.scenes.io.hdf5 import read_contents

    contents = read_contents(Path(path))
    arrays = contents.arrays()
    shapes = {name: [array.dtype.str, array.shape] for name, array in arrays.items()}
    values = {name: value for name, value in vars(contents).items() if name not in arrays}
    return {"values": values, "arrays": shapes}, list(arrays.values())


def _replace_features(dump: str, path: str, arrays: dict[str, str], attributes: dict[str, dict[str, str]]) -> Answer:
    import numpy as np

    from dirl.scenes.io.write import copy_with

    loaded = {name: np.load(file, mmap_mode="r") for name, file in arrays.items()}
    copy_with(Path(dump), Path(path), loaded, attributes)
    return {}, []


TASKS: dict[str, Callable[..., Answer]] = {"read": _read, "replace_features": _replace_features}


def _answer(stream: BinaryIO, header: dict[str, Any], arrays: list[Any]) -> None:
    stream.write(json.dumps(header).encode() + b"\n")
    for array in arrays:
        if array.size:  # an empty one cannot be cast
            stream.write(memoryview(array if array.flags.c_contiguous else array.copy()).cast("B"))
    stream.flush()


if __name__ == "__main__":
    main()
