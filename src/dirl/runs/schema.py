"""What a checkpoint holds, and which tables a run writes."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dirl.runs.paths import RunError

State = dict[str, Any]
"""A checkpoint by entry, see `ENTRIES`."""

Facts = dict[str, Any]
"""What is said of a run, for its summary."""

Summary = Mapping[str, Any]
"""What ``summary.json`` holds: facts of the run, and measures by policy, scene and goal."""

SCHEMA = 2
"""Of configurations and checkpoints."""

ENTRIES = ("network", "config", "extractor", "scenes", "views", "frames", "schema")
"""What every checkpoint holds; that of a training also what its loop goes on from."""

TABLES = ("dagger.csv", "evaluation.csv", "imitation.csv", "reinforcement.csv")
"""What a training writes rows to; other files of its folder are left alone."""


def check_entries(state: object, file: Path) -> State:
    """Return the content of a checkpoint if it has the entries that every one has.

    What they hold is not checked: the digest says that dirl wrote it, and weights are loaded strictly.

    Raises:
        RunError: it lacks one, or a newer version wrote it.
    """
    held: State = dict(state) if isinstance(state, dict) else {}
    missing = [name for name in ENTRIES if name not in held]
    if missing:
        raise RunError(f"{file}: is no checkpoint of dirl: it lacks {', '.join(missing)}")
    if held["schema"] != SCHEMA:
        raise RunError(f"{file}: was written by another version of dirl (schema {held['schema']}, not {SCHEMA})")
    return held
