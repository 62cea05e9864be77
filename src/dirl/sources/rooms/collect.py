"""Many random rooms in a collection, made in parallel; an interrupted command can be continued."""

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dirl.scenes.collection import INDEX, Entry, add_entry, is_whole, read_collection
from dirl.scenes.io.digest import file_digest
from dirl.scenes.io.processes import in_processes
from dirl.scenes.scene import SceneError
from dirl.sources.rooms.build import check_arguments, poses, take_views, write_room
from dirl.sources.rooms.description import description_text
from dirl.sources.rooms.looks import Changes, look_views
from dirl.sources.rooms.navigation import walk
from dirl.sources.rooms.sampling.sample import LOOK, sample_views
from dirl.sources.rooms.sampling.splits import split_of
from dirl.sources.rooms.view import Renderer

if TYPE_CHECKING:  # the models are built on the scenes
    from dirl.perception.backbones import ViewEncoder

LOOK_SEEDS = 1000
"""Looks of a room at most; the seed of a look is this many times the room's, and its number."""

Wanted = tuple[str, int]
"""A kind and a seed."""


@dataclass(frozen=True)
class RoomSettings:
    """How the rooms of a collection are made; the same for all of them.

    Args:
        height, width: of the views, pixels.
        turn: degrees of a turn.
        fine: the light of the built-in rooms; otherwise a coarser one, ten times faster.
        encoder: see `dirl.perception.backbones.load_encoder`; None for no features.
        precision: of the encoder.
        patches: whether to store patches too.
        fine_patches: whether to store fine ones.
        device: of the encoder; the only setting that rooms of one collection need not share.
        looks: further looks of each state; needs an encoder, since their views are not stored.
        changes: by how much these differ from the views of the dump.
    """

    height: int = 300
    width: int = 400
    turn: float = 90
    fine: bool = True
    encoder: str | None = "resnet50"
    precision: str = "float32"
    patches: bool = False
    fine_patches: bool = False
    device: str = "cpu"
    looks: int = 0
    changes: Changes = field(default_factory=Changes)

    def load_encoder(self) -> "ViewEncoder | None":
        """Return the encoder that the settings name."""
        if self.encoder is None:
            return None
        from dirl.perception.backbones import load_encoder

        patches = {"patches": self.patches, "fine_patches": self.fine_patches}
        return load_encoder(self.encoder, self.device, precision=self.precision, **patches)

    def stored(self, encoder: "ViewEncoder | None") -> dict[str, Any]:
        """Return the settings as the index stores them: the encoder by its description, not by its name."""
        kept = {key: getattr(self, key) for key in ("height", "width", "turn", "fine", "precision")}
        if self.looks:
            kept |= {"looks": self.looks, **{f"changes.{name}": value for name, value in vars(self.changes).items()}}
        kept |= {"extractor": "none" if encoder is None else encoder.extractor, "patches": "none"}
        if encoder is not None and (self.patches or self.fine_patches):
            kept |= {"patches": "; ".join(encoder.patch_attributes.values())}
        return kept


encoder_of = cache(RoomSettings.load_encoder)
"""What encodes the views, loaded once in each process."""


def missing_rooms(folder: Path, wanted: Sequence[Wanted], stored: dict[str, Any]) -> list[Wanted]:
    """Return the rooms that a collection lacks, or does not have completely and as the index describes them.

    The folder may not exist yet. For ``stored`` see `RoomSettings.stored`.

    Raises:
        SceneError: the folder holds something else, or rooms that were made with other settings.
    """
    if not (folder / INDEX).is_file():
        # A job that was killed before its first room was whole may have left a description and an unfinished dump.
        names = {f"{kind}_{seed}" for kind, seed in wanted}
        if folder.exists() and not (
            folder.is_dir() and {path.name.split(".")[0] for path in folder.iterdir()} <= names
        ):
            raise SceneError(f"{folder}: is there already, and is no collection; it is not written to")
        return list(wanted)
    collection = read_collection(folder)
    for entry in collection.entries:
        for key, value in stored.items():
            if entry.settings.get(key) != value:
                raise SceneError(
                    f"{folder}: {entry.name} was made with {key}={entry.settings.get(key)}, not {value}; give the same "
                    "options, or another folder"
                )
    whole = {(e.kind, e.seed) for e in collection.entries if is_whole(collection.path(e), e)}
    return [one for one in wanted if one not in whole]


def make_rooms(
    folder: str | Path, wanted: Sequence[Wanted], settings: RoomSettings, workers: int | None = None
) -> Iterator[Entry | SceneError]:
    """Make random rooms: the dump of each, its description beside it, and a line in the index.

    Each process makes one room at a time; the views of a single room are rendered by all. The rooms do not depend on
    the number of processes.

    Args:
        folder: the collection's.
        wanted: kinds and seeds.
        settings: how they are made.
        workers: processes; all cores if left out. Each needs about 1 GB.

    Yields:
        The entries of complete rooms; for a seed of which no attempt passed the checks, the error.

    Raises:
        SceneError: the rooms cannot be made, or a process was killed, perhaps because memory ran out.
    """
    check_arguments((settings.height, settings.width))
    if not 0 <= settings.looks <= LOOK_SEEDS:
        raise SceneError(f"looks={settings.looks}: must be 0 to {LOOK_SEEDS}")
    if settings.looks and settings.encoder is None:
        raise SceneError(f"looks={settings.looks}: their views are encoded and not stored; give an encoder")
    workers = workers or os.cpu_count() or 1
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    made: Iterable[Entry | SceneError]
    if workers == 1 or len(wanted) == 1:
        made = (make_room(folder, one, settings) for one in wanted)
    else:
        tasks = [partial(make_room, folder, one, settings, threads=1) for one in wanted]
        made = in_processes(tasks, min(workers, len(wanted)), f"{folder}: a process that made a room")
    for one in made:
        if isinstance(one, Entry):
            add_entry(folder, one)
        yield one


def make_room(folder: Path, one: Wanted, settings: RoomSettings, *, threads: int | None = None) -> Entry | SceneError:
    """Draw a room, take and encode its views, and write its dump and its description; see `make_rooms`."""
    kind, seed = one
    encoder = encoder_of(settings)
    try:
        room, views = sample_views(kind, seed, threads=threads)
    except SceneError as error:
        return error
    way, size, looks = walk(room, settings.turn), (settings.height, settings.width), []
    checked = size == LOOK and not settings.fine and settings.turn == 90  # then the views of the check serve
    if settings.looks or not checked:
        renderer = Renderer.of(room, fine=settings.fine)
        if not checked:
            views = list(take_views(renderer, room.camera, poses(way), size, threads=threads, progress=False))
        taken = partial(look_views, renderer, room.camera, way, size, settings.changes)
        looks = [list(taken(LOOK_SEEDS * seed + k)) for k in range(settings.looks)]
    dump = folder / f"{room.name}.h5"
    unfinished = folder / f"{room.name}.toml.tmp"
    unfinished.write_text(description_text(room), encoding="utf-8")
    os.replace(unfinished, folder / f"{room.name}.toml")  # also over what a killed job left
    problems = write_room(dump, room, way, views, encoder, {"turn": settings.turn, "seed": seed}, looks=looks)
    return Entry(
        name=room.name,
        kind=kind,
        seed=seed,
        split=split_of(seed),
        states=len(way.graph),
        checks={
            "size": list(room.size),
            "pieces": len(room.furniture),
            "places": room.grid.places,
            "problems": problems,
        },
        settings=settings.stored(encoder),
        sha256=file_digest(dump),
    )
