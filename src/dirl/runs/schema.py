"""What a checkpoint holds, and which tables a run writes."""

from pathlib import Path
from typing import Any

from dirl.runs.paths import RunError

SCHEMA = 2
"""Of configurations and checkpoints."""

ENTRIES = ("network", "config", "extractor", "scenes", "views", "frames", "schema")
"""What every checkpoint holds; that of a training also what its loop goes on from."""

TABLES = ("dagger.csv", "evaluation.csv", "imitation.csv", "reinforcement.csv")
"""What a training writes rows to; other files of its folder are left alone."""


def check_entries(state: Any, file: Path) -> dict[str, Any]:
    """Return the content of a checkpoint if it has the entries that every one has.

    What they hold is not checked: the digest says that dirl wrote it, and weights are loaded strictly.

    Raises:
        RunError: it lacks one, or a newer version wrote it.
    """
    missing = [name for name in ENTRIES if not isinstance(state, dict) or name not in state]
    if missing:
        raise RunError(f"{file}: is no checkpoint of dirl: it lacks {', '.join(missing)}")
    if state["schema"] != SCHEMA:
        raise RunError(f"{file}: was written by another version of dirl (schema {state['schema']}, not {SCHEMA})")
    turns = state.get("turns", [4])
    if not isinstance(turns, list) or not all(type(number) is int and number > 0 for number in turns):
        raise RunError(f"{file}: is no checkpoint of dirl: turns={turns!r:.50}")
    return dict(state)
