"""Many random rooms in a collection, made in parallel; an interrupted command can be continued."""

import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

import h5py

from dirl.scenes.catalogue import ROOM, split_of
from dirl.scenes.io.files import write_text
from dirl.scenes.io.processes import in_processes
from dirl.scenes.scene import SceneError
from dirl.sources.rooms.description import description_text
from dirl.sources.rooms.dump import Changes, check_arguments, look_views, poses, take_views, write_room
from dirl.sources.rooms.sampling.sample import LOOK, sample_views
from dirl.sources.rooms.view import Renderer
from dirl.sources.rooms.walkable import walk

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
        return load_encoder(self.encoder, self.device, **patches)

    def stored(self, encoder: "ViewEncoder | None") -> dict[str, object]:
        """Return the settings as each room stores them: the encoder by its description, not by its name."""
        kept = asdict(self)
        del kept["device"], kept["encoder"]
        kept["extractor"] = "none" if encoder is None else encoder.extractor
        if encoder is not None and (self.patches or self.fine_patches):
            kept["patches"] = "; ".join(encoder.patch_attributes.values())
        return kept


encoder_of = cache(RoomSettings.load_encoder)
"""What encodes the views, loaded once in each process."""


@dataclass(frozen=True)
class MadeRoom:
    """A room that was made: its name and split, what is in it, and the problems that were found."""

    name: str
    split: str | None
    size: tuple[float, float, float]
    pieces: int
    places: int
    states: int
    problems: list[str]


def missing_rooms(folder: Path, wanted: Sequence[Wanted], stored: dict[str, object]) -> list[Wanted]:
    """Return the rooms that a collection lacks; a dump is there completely or not at all.

    The folder may not exist yet. For ``stored`` see `RoomSettings.stored`.

    Raises:
        SceneError: the folder holds something else, or a room that was made with other settings or cannot be read.
    """
    if not folder.exists():
        return list(wanted)
    if not folder.is_dir() or not all(
        ROOM.fullmatch(path.name.split(".")[0]) for path in folder.iterdir() if not path.name.startswith(".")
    ):
        raise SceneError(f"{folder}: is there already, and is no collection; it is not written to")
    for path in sorted(folder.glob("[!.]*.h5")):
        try:
            with h5py.File(path) as file:
                used = json.loads(file.attrs["settings"])
        except (OSError, KeyError, ValueError) as error:
            raise SceneError(f"{path}: says not how it was made ({error}); delete it, or name another folder") from None
        for key, value in stored.items():
            if used.get(key) != value:
                raise SceneError(
                    f"{folder}: {path.stem} was made with {key}={used.get(key)}, not {value}; give the same options, "
                    "or another folder"
                )
    return [(kind, seed) for kind, seed in wanted if not (folder / f"{kind}_{seed}.h5").is_file()]


def make_rooms(
    folder: str | Path, wanted: Sequence[Wanted], settings: RoomSettings, workers: int | None = None
) -> Iterator[MadeRoom | SceneError]:
    """Make random rooms: the dump of each, and its description beside it.

    Each process makes one room at a time, and needs about 1 GB; the views of a single room are rendered by all. There
    are so many ``workers``, or one for each core if they are left out; the rooms do not depend on their number.

    Yields:
        What was made; for a seed of which no attempt passed the checks, the error.

    Raises:
        SceneError: the rooms cannot be made, or a process was killed, perhaps because memory ran out.
    """
    check_arguments((settings.height, settings.width))
    if settings.looks and settings.encoder is None:
        raise SceneError(f"looks={settings.looks}: their views are encoded and not stored; give an encoder")
    workers = workers or os.cpu_count() or 1
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    if workers == 1 or len(wanted) == 1:
        yield from (make_room(folder, room, settings) for room in wanted)
    else:
        tasks = [partial(make_room, folder, room, settings, threads=1) for room in wanted]
        yield from in_processes(tasks, min(workers, len(wanted)), f"{folder}: a process that made a room")


def make_room(
    folder: Path, wanted: Wanted, settings: RoomSettings, *, threads: int | None = None
) -> MadeRoom | SceneError:
    """Draw a room, take and encode its views, and write its dump and its description; see `make_rooms`."""
    kind, seed = wanted
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
            views = list(take_views(renderer, room.camera, poses(way), size, threads=threads))
        taken = partial(look_views, renderer, room.camera, way, size, settings.changes)
        looks = [list(taken(LOOK_SEEDS * seed + k)) for k in range(settings.looks)]
    write_text(folder / f"{room.name}.toml", description_text(room))  # also over what a killed job left
    attributes = {"turn": settings.turn, "seed": seed, "settings": json.dumps(settings.stored(encoder))}
    problems = write_room(folder / f"{room.name}.h5", room, way, views, encoder, attributes, looks=looks)
    places, states = len(way.places), len(way.graph)
    return MadeRoom(room.name, split_of(seed), room.size, len(room.furniture), places, states, problems)
