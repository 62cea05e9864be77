"""The program that reads dumps of unknown origin, started by `dirl.scenes.io.isolation` and never imported.

It reads one request, JSON, from its standard input, and writes an ``.npz`` for each of its tasks.
"""

import json
import math
import os
import sys
import types
from contextlib import suppress
from pathlib import Path
from typing import Any


def main() -> None:
    """Do the tasks of the request."""
    _skip_the_packages()
    from dirl.scenes.scene import SceneError

    request = json.load(sys.stdin)
    _limit("RLIMIT_AS", request["memory"])
    for task in request["tasks"]:
        _limit("RLIMIT_CPU", task["seconds"] + sum(os.times()[:2]))
        try:
            answer = _done(**task["arguments"])
        except (SceneError, OSError, MemoryError) as error:
            answer = {"error": str(error) if isinstance(error, SceneError) else f"{type(error).__name__}: {error}"}
        _write(Path(task["answer"]), answer)


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


def _done(dump: str, copy: dict[str, Any] | None = None) -> dict[str, Any]:
    """The contents of a dump; or nothing, after a copy of it with other datasets was written."""
    if copy is None:
        from dirl.scenes.io.hdf5 import read_contents

        return read_contents(Path(dump))
    import numpy as np

    from dirl.scenes.io.write import copy_with

    arrays = {name: np.load(file, mmap_mode="r") for name, file in copy["arrays"].items()}
    copy_with(Path(dump), Path(copy["path"]), arrays, copy["attributes"])
    return {}


def _write(file: Path, answer: dict[str, Any]) -> None:
    """Write an answer, whole or not at all: its arrays, and everything else as one JSON text."""
    import numpy as np

    arrays: dict[str, Any] = {name: value for name, value in answer.items() if isinstance(value, np.ndarray)}
    values = {name: value for name, value in answer.items() if name not in arrays}
    unfinished = file.with_suffix(".unfinished.npz")
    np.savez(unfinished, json=json.dumps(values), **arrays)
    os.replace(unfinished, file)


if __name__ == "__main__":
    main()
