"""Where runs and checkpoints are on disk, and what they hold."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Ge, MinLen

from dirl.scenes.io.checked import checked
from dirl.scenes.scene import SceneError

AGENTS = Path(__file__).parents[1] / "agents"
"""Trained agents that come with the package, each in the folder of its name."""

ARCHITECTURE = ("observation", "encoder", "memory", "heads", "policy", "network")
"""The options that decide which weights a policy has, and what they read."""

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


class RunError(ValueError):
    """A run folder or checkpoint that cannot be used."""


def config_file(folder: Path) -> Path:
    """Return the configuration file, by which a run folder is recognised."""
    return folder / "config.yaml"


def is_finished(folder: Path) -> bool:
    """True if a folder holds a finished run."""
    return (folder / "summary.json").exists() and not training_checkpoints(folder)


def training_checkpoints(folder: Path) -> list[Path]:
    """Return the checkpoints from which an unfinished run can be resumed, oldest first."""
    return sorted(file for file in (folder / "checkpoints").glob("*.pt") if file.stem.isdecimal())


def packaged_agent(name: str | Path) -> Path | None:
    """Return the folder of an agent in `AGENTS`; None if there is none, or the name is in the present folder."""
    path = Path(name)
    return AGENTS / path if not path.exists() and path.name == str(name) and (AGENTS / path).is_dir() else None


def find_checkpoint(path: str | Path) -> Path:
    """Return the file of a checkpoint, or the folder of an unfinished run; see `load_checkpoint`.

    Raises:
        RunError: there is none.
    """
    path = packaged_agent(path) or Path(path)
    file = path / "network.pt" if path.is_dir() else path
    if file.is_file():
        return file
    if path.is_dir() and training_checkpoints(path):
        return path
    raise RunError(f"{path}: holds no checkpoint; expected the folder of a run or a .pt file")


def find_unfinished(resume: str, overrides: Sequence[str]) -> Path:
    """Return the folder of the run that ``resume`` names.

    Raises:
        RunError: it is no run's, its run is finished, or options were given together with ``resume``.
    """
    others = [text for text in overrides if not text.startswith(("resume=", "trust="))]
    if others:
        raise RunError(f"resume uses the saved configuration; leave out {' '.join(others)}")
    folder = Path(resume)
    if not config_file(folder).is_file():
        raise RunError(f"{folder}: is not the folder of a run; it has no {config_file(folder).name}")
    if is_finished(folder):
        raise RunError(f"{folder}: the run is finished; its result is in {folder / 'summary.json'}")
    return folder


def finished_folders(folder: Path, hint: str) -> tuple[list[Path], list[Path]]:
    """Return the finished runs right in a folder, by name, and those that are not finished.

    Raises:
        RunError: none is finished; ``hint`` says how to make them.
    """
    folders = sorted(file.parent for file in folder.glob("*/config.yaml"))
    finished = [one for one in folders if is_finished(one)]
    if not finished:
        raise RunError(f"{folder}: holds no finished run; make some by: {hint}")
    return finished, [one for one in folders if one not in finished]


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
