"""The available scenes by name: built-in rooms, published dumps, any file."""

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from tqdm import tqdm

from dirl.scenes.collection import Collection, read_collection
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

SOURCES = ("rooms", "thor")


def load_scenes(
    scene: str | Sequence[str],
    *,
    source: str = "rooms",
    root: str | Path | None = None,
    split: str | None = None,
    rooms: int | None = None,
) -> list[Scene]:
    """Read the scenes a user asks for.

    Args:
        scene: a name, several names, ``all`` (the four of the paper), paths of dump files, or ``collection:`` and the
            folder of a collection.
        source: ``rooms`` for the built-in rooms, ``thor`` for the published dumps a user owns.
        root: the folder of the published dumps, one ``<name>.h5`` a scene; required for ``thor``.
        split: of a collection's rooms; all if left out.
        rooms: the first so many of them; all if left out.

    Raises:
        SceneError: no such scene (the message lists the choices), or an invalid file.
    """
    collection = find_rooms(scene, split, rooms)
    if collection is not None:
        return list(tqdm(collection, desc="rooms", disable=None))
    scenes = read_dumps(find_scenes(scene, source=source, root=root))
    return [made if made.goals else replace(made, goals=PUBLISHED_GOALS.get(made.name, ())) for made in scenes]


def find_rooms(scene: str | Sequence[str], split: str | None, rooms: int | None) -> Collection | None:
    """The rooms of a collection that a user asks for, not read yet; None if it is none. See `load_scenes`.

    Raises:
        SceneError: no such collection, or none of its rooms.
    """
    if (folder := collection_folder(scene)) is not None:
        return read_collection(folder).select(split=split)[:rooms]
    if split is not None or rooms is not None:
        raise SceneError("split and rooms choose among the rooms of a collection: scene=collection:<folder>")
    return None


def collection_folder(scene: str | Sequence[str]) -> Path | None:
    """The folder of the collection whose rooms a user asks for, see `load_scenes`; None if single scenes are named."""
    name = scene if isinstance(scene, str) else scene[0] if len(scene) == 1 else ""
    return Path(name.removeprefix(COLLECTION)) if name.startswith(COLLECTION) else None


def find_scenes(scene: str | Sequence[str], *, source: str = "rooms", root: str | Path | None = None) -> list[Dump]:
    """The dumps of the scenes a user asks for, not read yet; see `load_scenes`.

    Raises:
        SceneError: no such scene.
    """
    folder = _folder(source, root)
    names = [scene] if isinstance(scene, str) else list(scene)
    if not names:
        raise SceneError("no scene is named; choose e.g. scene=bathroom_02")
    if "all" in names:
        if len(names) > 1:
            raise SceneError(f"'all' already stands for {list(PUBLISHED_GOALS)}; name it alone")
        names = list(PUBLISHED_GOALS)
    dumps = []
    for name in names:
        is_file = Path(name).suffix in (".h5", ".hdf5")
        path = Path(name) if is_file else folder / f"{name}.h5"
        if not path.is_file():
            raise SceneError(_no_such_scene(name, is_file, folder))
        label = source if source == "thor" or not is_file else None
        dumps.append(Dump(path, name=None if is_file else name, source=label))
    return dumps


def _folder(source: str, root: str | Path | None) -> Path:
    if source not in SOURCES:
        raise SceneError(f"there is no source '{source}'; choose one of {list(SOURCES)}")
    if source == "rooms":
        return ROOMS
    if root is None:
        raise SceneError("source=thor needs the folder of your dumps: source.root=/path/to/dumps")
    if not Path(root).is_dir():
        raise SceneError(f"source.root={root}: there is no such folder")
    return Path(root)


def _no_such_scene(name: str, is_file: bool, folder: Path) -> str:
    if is_file:
        return f"{name}: there is no such file"
    choices = sorted(path.stem for path in folder.glob("*.h5"))
    if not choices:
        return f"{folder}: holds no dump files; expected {name}.h5"
    near = difflib.get_close_matches(name, [*choices, "all"], n=1)
    hint = f" (did you mean '{near[0]}'?)" if near else ""
    return (
        f"there is no scene '{name}'{hint}; choose from {[*choices, 'all']}, a list of them such as "
        f"[{','.join(choices[:2])}], or the path of a dump file (.h5)"
    )
