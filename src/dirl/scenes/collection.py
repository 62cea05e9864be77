"""Collections: folders of many dumps with an index, from which scenes are read on access.

``collection.jsonl`` has one line of JSON for each complete room. Lines are only ever appended, so that several
processes can add rooms, and one that is killed leaves at most an unfinished line, which is ignored. Of two lines with
one name the later one counts.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, overload

from dirl.scenes.io.bounded import read_text
from dirl.scenes.io.checked import checked
from dirl.scenes.io.digest import file_digest
from dirl.scenes.io.read import Dump, read_dumps
from dirl.scenes.scene import Scene, SceneError

INDEX = "collection.jsonl"

UNFINISHED = "\0"
"""Ends a line that was cut short by a killed process."""


@dataclass(frozen=True)
class Entry:
    """The index entry of one room.

    Args:
        name: of the room; its dump is ``<name>.h5``.
        kind: bathroom, bedroom, kitchen or living_room.
        seed: of its drawing.
        split: train, validation or test; None for a room of none of them.
        states: how many it has.
        checks: what was found in it, by name; ``problems`` is a list of lines.
        settings: how it was made, by name; rooms of one collection share them.
        sha256: of the dump.
    """

    name: str
    kind: str
    seed: int
    split: str | None
    states: int
    checks: dict[str, Any]
    settings: dict[str, Any]
    sha256: str


@dataclass(frozen=True)
class Collection(Sequence[Scene]):
    """The scenes of a folder. Each is read on access, and not kept in memory.

    Args:
        folder: holds the dumps.
        entries: the rooms, in the order of their seeds, kinds interleaved.
    """

    folder: Path
    entries: tuple[Entry, ...]

    def __len__(self) -> int:
        """Return the number of rooms."""
        return len(self.entries)

    @overload
    def __getitem__(self, index: int) -> Scene: ...
    @overload
    def __getitem__(self, index: slice) -> "Collection": ...
    def __getitem__(self, index: int | slice) -> "Scene | Collection":
        """One scene, read now, `SceneError` if its dump is not as the index says; or some of the rooms."""
        if isinstance(index, slice):
            return replace(self, entries=self.entries[index])
        entry = self.entries[index]
        # A file that is as it was written is read in this process: to start another takes longer than to read a room.
        (scene,) = read_dumps([Dump(self.path(entry), entry.name, sha256=entry.sha256)])
        if len(scene) != entry.states:
            raise SceneError(f"{scene.origin}: has {len(scene)} states; {INDEX} says {entry.states}")
        return scene

    def path(self, entry: Entry) -> Path:
        """Return the dump of a room."""
        return self.folder / f"{entry.name}.h5"

    def select(self, *, split: str | None = None) -> "Collection":
        """Return the rooms of a split, or all of them; `SceneError` if there are none."""
        chosen = tuple(entry for entry in self.entries if split in (None, entry.split))
        if not chosen:
            splits = sorted({entry.split or "none" for entry in self.entries})
            raise SceneError(f"{self.folder}: has no room with split={split}; splits: {splits}")
        return replace(self, entries=chosen)

    def damaged(self) -> Iterator[str]:
        """Yield the names of rooms whose dumps are missing or differ from the index; reads every file."""
        yield from (entry.name for entry in self.entries if not is_whole(self.path(entry), entry))


def read_collection(folder: str | Path) -> Collection:
    """Return the collection in a folder; no dump is read.

    Raises:
        SceneError: the folder holds no index, or it cannot be understood; the message names the line.
    """
    folder = Path(folder)
    index = folder / INDEX
    if not index.is_file():
        raise SceneError(f"{folder}: is no collection; it holds no {INDEX} (made by: scenes.py sample)")
    entries: dict[str, Entry] = {}
    try:
        *lines, _ = read_text(index, errors="replace").split("\n")  # what follows the last is unfinished
    except ValueError as error:
        raise SceneError(str(error)) from None
    for number, line in enumerate(lines, 1):
        if line.endswith(UNFINISHED) or not line:
            continue
        where = f"{index}: line {number}"
        try:
            entry: Entry = checked(json.loads(line), Entry, where)
        except json.JSONDecodeError as error:
            raise SceneError(f"{where}: is no entry of a collection ({error})") from None
        if Path(entry.name).name != entry.name:
            raise SceneError(f"{where}: name: expected one without slashes, found {entry.name!r}")
        entries[entry.name] = entry
    return Collection(folder, tuple(sorted(entries.values(), key=lambda entry: (entry.seed, entry.kind))))


def add_entry(folder: Path, entry: Entry) -> None:
    """Append a room to the index of a collection, which is made if there is none."""
    line = json.dumps(asdict(entry), sort_keys=True) + "\n"
    with (folder / INDEX).open("a+b") as file:
        if file.tell():
            file.seek(-1, 2)
            line = line if file.read() == b"\n" else f"{UNFINISHED}\n{line}"
        file.write(line.encode())  # in one piece: the file is opened for appending


def is_whole(dump: Path, entry: Entry) -> bool:
    """True if a dump exists and is the one that the index describes."""
    return dump.is_file() and file_digest(dump) == entry.sha256
