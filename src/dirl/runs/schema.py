"""What a checkpoint holds, and which tables a run writes."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Ge, MinLen

from dirl.runs.paths import RunError
from dirl.scenes.io.checked import checked
from dirl.scenes.scene import SceneError

State = dict[str, Any]
"""A checkpoint by entry: ``network``, the weights, `Stated`, and of a training what its loop goes on from."""

Facts = dict[str, Any]
"""What is said of a run, for its summary."""

Summary = Mapping[str, Any]
"""What ``summary.json`` holds: facts of the run, and measures by policy, scene and goal."""

SCHEMA = 2
"""Of configurations and checkpoints."""


@dataclass(frozen=True)
class Stated:
    """What every checkpoint says of its weights."""

    config: str
    extractor: str
    scenes: Annotated[tuple[str, ...], MinLen(1)]
    views: Annotated[tuple[str, ...], MinLen(1)]
    """What the four images of an observation show, in their order."""
    frames: Annotated[int, Ge(0)]
    schema: int
    turns: tuple[Annotated[int, Ge(4)], ...] = (4,)
    """Right turns in a full circle, in the scenes of the training."""


TABLES = ("dagger.csv", "evaluation.csv", "imitation.csv", "reinforcement.csv")
"""What a training writes rows to; other files of its folder are left alone."""


def check_entries(state: object, file: Path) -> State:
    """Return the content of a checkpoint if it says of its weights what every one says; they are loaded strictly.

    Raises:
        RunError: it does not, or a newer version wrote it.
    """
    held: State = dict(state) if isinstance(state, dict) else {}
    if "network" not in held:
        raise RunError(f"{file}: is no checkpoint of dirl: it has no network")
    if held.get("schema") != SCHEMA:
        raise RunError(f"{file}: was written by another version of dirl (schema {held.get('schema')}, not {SCHEMA})")
    names = [field.name for field in fields(Stated)]
    try:
        checked({name: held[name] for name in names if name in held}, Stated)
    except SceneError as error:
        raise RunError(f"{file}: is no checkpoint of dirl: {error}") from None
    return held
