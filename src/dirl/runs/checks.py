"""Whether a checkpoint can be one of a run with given options; without torch, so that recipes refuse at once."""

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dirl.config.schemas import TrainConfig

SCHEMA = 2
"""Of configurations and checkpoints; 1 was dirl 0.1."""


TABLES = ("dagger.csv", "evaluation.csv", "imitation.csv", "reinforcement.csv")
"""What a training writes rows to; other files of its folder are left alone."""


class RunError(ValueError):
    """A run folder or checkpoint that cannot be used."""


def is_count(value: Any) -> bool:
    """Whether it is a number of things, as frames or bytes."""
    return type(value) is int and 0 <= value < 2**63


def check_progress(file: Path, state: Mapping[str, Any], config: TrainConfig) -> None:
    """Raise `RunError` unless a run with these options can have a checkpoint's counts."""
    missing = {"schema", "tables", "seconds"} - state.keys()
    if missing:
        raise RunError(f"{file}: is no checkpoint of a training; it lacks {' and '.join(sorted(missing))}")
    options, scenes = config.reinforcement, len(state["scenes"])
    most = scenes * (options.frames_per_scene + options.agents_per_scene * options.n_steps)  # the last rollout is whole
    if state["frames"] != int(file.stem) or state["frames"] > most:
        raise RunError(f"{file}: counts {state['frames']} frames, where its name and options have others")
    for table in (file.parent.parent / name for name in TABLES if name not in state["tables"]):
        if table.is_file() and _begins_before(table, state["frames"]):
            raise RunError(f"{file}: knows nothing of {table}, whose rows would be lost")
    for name, size in state["tables"].items():
        table = file.parent.parent / name
        if not table.is_file() or table.stat().st_size < size:
            raise RunError(f"{file}: does not fit {table}, which is shorter than it was, or missing")


def _begins_before(table: Path, frames: int) -> bool:
    """Whether the first row of a table is older than a checkpoint at so many frames; rows without frames always are."""
    with table.open(newline="", errors="replace") as stream:
        row = next(csv.DictReader(stream), None)
    if row is None:
        return False
    try:
        return "frames" not in row or (frames > 0 and float(row["frames"]) <= frames)
    except (TypeError, ValueError):
        return True
