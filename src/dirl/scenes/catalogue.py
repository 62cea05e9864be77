"""The available scenes by name: built-in rooms, published dumps, any file."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol

from dirl.scenes.io.files import check_choice
from dirl.scenes.io.read import ROOMS, Dump, read_dumps
from dirl.scenes.scene import Scene, SceneError

PUBLISHED_GOALS: Mapping[str, tuple[int, ...]] = {
    "bathroom_02": (26, 37, 43, 53, 69),
    "bedroom_04": (134, 264, 320, 384, 387),
    "kitchen_02": (90, 136, 157, 207, 329),
    "living_room_08": (92, 135, 193, 228, 254),
}
"""The four scenes of the paper with the goals of the published target-driven navigation code, five each."""

COLLECTION = "collection:"

ROOM = re.compile(r"([a-z_]+)_(\d+)")
"""What the dumps of a collection are called: a kind and a seed, as ``bathroom_30000.h5``."""

FIRST_SEEDS = {"test": 10_000, "validation": 20_000, "train": 30_000}
"""The first seed of each split; it ends where the next begins."""


class SceneSource(Protocol):
    """Where scenes are looked up by name: a class of one's own, named by ``source._target_``."""

    def load(self, names: list[str]) -> Sequence[Scene]:
        """Return the scenes of these names, as ``scene=`` gives them; `SceneError` if there is no such."""


class Rooms:
    """The built-in rooms; a `SceneSource`, whose names may also be files."""

    label = "rooms"
    """The source of its scenes."""

    folder = ROOMS
    """Holds the dumps."""

    def load(self, names: list[str]) -> list[Scene]:
        """Return the scenes of these names or files."""
        if not names:
            raise SceneError("no scene is named; choose e.g. scene=bathroom_02")
        if "all" in names:
            if len(names) > 1:
                raise SceneError(f"'all' already stands for {list(PUBLISHED_GOALS)}; name it alone")
            names = list(PUBLISHED_GOALS)
        dumps = []
        for name in names:
            if _is_file(name):
                dumps.append(Dump(Path(name), source=None if self.label == "rooms" else self.label))
                continue
            path = self.folder / f"{name}.h5"
            if not path.is_file():
                known = sorted(path.stem for path in self.folder.glob("*.h5"))
                choices = [*known, "all", "a list of them", "<a dump>.h5", "collection:<a folder>"]
                check_choice(name, choices, "", "scene")
            dumps.append(Dump(path, name=name, source=self.label))
        scenes = read_dumps(dumps)
        return [scene if scene.goals else replace(scene, goals=PUBLISHED_GOALS.get(scene.name, ())) for scene in scenes]


class Thor(Rooms):
    """The published dumps of AI2-THOR, of which a user has a copy in the folder ``root``, one ``<name>.h5`` a scene."""

    label = "thor"

    def __init__(self, root: str | None = None) -> None:
        self.root = root

    def load(self, names: list[str]) -> list[Scene]:
        """Return the scenes of these names or files; `SceneError` if there is no folder to look a name up."""
        if not all(map(_is_file, names)):
            if self.root is None:
                raise SceneError("source=thor needs the folder of your dumps: source.root=/path/to/dumps")
            self.folder = Path(self.root)
            if not self.folder.is_dir():
                raise SceneError(f"source.root={self.root}: there is no such folder")
        return super().load(names)


def load_scenes(
    scene: str | Sequence[str],
    *,
    source: SceneSource | None = None,
    split: str | None = None,
    rooms: int | None = None,
) -> list[Scene]:
    """Read the scenes a user asks for.

    Args:
        scene: a name, several names, ``all`` (the four of the paper), paths of dump files, or ``collection:`` and the
            folder of a collection.
        source: `Thor` for the published dumps a user owns, or a source of one's own, which is asked for all names that
            are no files; the built-in rooms if left out.
        split: of a collection's rooms; all if left out.
        rooms: the first so many of them; all if left out.

    Raises:
        SceneError: no such scene (the message lists the choices), an invalid file, or a source that gives no scenes.
    """
    if (folder := collection_folder(scene)) is not None:
        return read_dumps([Dump(path) for path in collection_files(folder, split)[:rooms]])
    if split is not None or rooms is not None:
        raise SceneError("split and rooms choose among the rooms of a collection: scene=collection:<folder>")
    names = [scene] if isinstance(scene, str) else list(scene)
    if source is None or isinstance(source, Rooms):
        return (source or Rooms()).load(names)
    own = [name for name in names if not _is_file(name)]
    files = Rooms().load([name for name in names if _is_file(name)]) if len(own) < len(names) else []
    return files + (_own_scenes(source, own) if own or not names else [])


def _own_scenes(source: SceneSource, names: list[str]) -> list[Scene]:
    """Return the scenes of a user's own source, which may do anything."""
    kind = type(source).__name__
    if not callable(getattr(source, "load", None)):
        raise SceneError(f"source: {kind} has no method load(names); see dirl.scenes.catalogue.SceneSource")
    if not names:
        raise SceneError(f"no scene is named; choose e.g. scene=<a name that {kind} knows>")
    try:
        scenes = list(source.load(names))
    except SceneError:
        raise
    except (LookupError, OSError, TypeError, ValueError) as error:
        raise SceneError(f"source: {kind}.load({names}) failed ({type(error).__name__}: {error})") from error
    others = sorted({type(other).__name__ for other in scenes if not isinstance(other, Scene)})
    if others or not scenes:
        problem = f"with {', '.join(others)}" if others else "without any"
        raise SceneError(f"source: {kind}.load({names}) must return a list of dirl.scenes.Scene, not one {problem}")
    return scenes


def _is_file(name: str) -> bool:
    return Path(name).suffix.lower() in (".h5", ".hdf5")


def collection_folder(scene: str | Sequence[str]) -> Path | None:
    """Return the folder of the collection that a user asks for, see `load_scenes`; None if single scenes are named."""
    name = scene if isinstance(scene, str) else scene[0] if len(scene) == 1 else ""
    return Path(name.removeprefix(COLLECTION)) if name.startswith(COLLECTION) else None


def split_of(seed: int) -> str | None:
    """Return the split that the rooms of a seed belong to: test, validation or train; None below all of them."""
    splits = [split for split, first in FIRST_SEEDS.items() if seed >= first]
    return splits[-1] if splits else None


def collection_files(folder: Path, split: str | None) -> list[Path]:
    """Return the dumps of a collection, or of one of its splits, by seed; `SceneError` if there are none."""
    rooms = [(int(name[2]), name[1], path) for path in folder.glob("*.h5") if (name := ROOM.fullmatch(path.stem))]
    if not rooms:
        raise SceneError(f"{folder}: is no collection; it holds no rooms such as bathroom_30000.h5 (scenes.py sample)")
    chosen = [path for seed, _, path in sorted(rooms) if split in (None, split_of(seed))]
    if not chosen:
        splits = sorted({split_of(seed) or "none" for seed, _, _ in rooms})
        raise SceneError(f"{folder}: has no room with split={split}; splits: {splits}")
    return chosen
