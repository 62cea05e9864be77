"""From a description of a room to a dump file: its graph, its views, their features."""

import importlib.util
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from tqdm import tqdm

from dirl.scenes.io.write import write_dump
from dirl.scenes.scene import Scene, SceneError
from dirl.scenes.views import decode, encode
from dirl.sources.rooms.checks import check_room, check_views, contrast, thumbnail
from dirl.sources.rooms.description import Camera, RoomDescription, description_text, read_description
from dirl.sources.rooms.mesh import Array
from dirl.sources.rooms.navigation import Walk, walk
from dirl.sources.rooms.view import Pose, Renderer

if TYPE_CHECKING:  # the models are built on the scenes
    from dirl.perception.backbones import ViewEncoder

DESCRIPTIONS = Path(__file__).parent / "descriptions"
"""The built-in rooms, one TOML file each."""

QUALITY = 72
"""Of the stored WebP views."""


def built_in_rooms() -> list[str]:
    """Return the names of the rooms that come with the package."""
    return sorted(path.stem for path in DESCRIPTIONS.glob("*.toml"))


def describe_room(description: str | Path | RoomDescription) -> RoomDescription:
    """Return the description itself, that of a built-in room by its name, or one read from a TOML file.

    Raises:
        SceneError: there is no such room or file, or it is invalid.
    """
    if isinstance(description, RoomDescription):
        return description
    if Path(description).suffix == ".toml":
        return read_description(description)
    if str(description) not in built_in_rooms():
        choices = ", ".join(built_in_rooms())
        raise SceneError(f"there is no built-in room '{description}'; choose from {choices}, or name a .toml file")
    return read_description(DESCRIPTIONS / f"{description}.toml")


def build_room(
    description: str | Path | RoomDescription,
    out: str | Path,
    *,
    size: tuple[int, int] = (300, 400),
    turn: float = 90,
    workers: int | None = None,
    encoder: "ViewEncoder | None" = None,
    quality: int = QUALITY,
    fine: bool = True,
    progress: bool = True,
) -> list[str]:
    """Light a room, render the view of every state, and write a scene dump.

    Needs the extra ``rooms``. The same description gives the same file on one machine, whatever the number of workers;
    on another machine the same graph, and views that differ by rounding.

    Args:
        description: a built-in room by name, a TOML file, or a description made in memory.
        out: the dump to write, completely or not at all.
        size: height and width of the views, pixels.
        turn: degrees of a turn, see `walk`.
        workers: processes that render views; up to one for each core if left out. Each needs about 0.5 GB.
        encoder: what makes the features, from the views as they are stored; no features if left out.
        quality: of the stored WebP views, 0 to 100.
        fine: the light of the built-in rooms; otherwise a coarser one, ten times faster.
        progress: show a progress bar.

    Returns:
        The problems that `check_room` and `check_views` found, one line each.

    Raises:
        SceneError: the room cannot be made, ``out`` exists, or an argument is out of range. All this is detected
            before the long work begins.
    """
    check_arguments(size, workers)
    room, out = describe_room(description), Path(out)
    if out.exists():
        raise SceneError(f"{out}: this file exists already; it is not overwritten")
    way = walk(room, turn)
    source = "rooms" if str(description) in built_in_rooms() else "synthetic"
    views = list(take_views(Renderer.of(room, fine=fine), room.camera, poses(way), size, quality, workers, progress))
    return write_room(out, room, way, views, encoder, {"turn": float(turn)}, source=source, progress=progress)


def check_arguments(size: tuple[int, int], workers: int | None) -> None:
    """Raise `SceneError` unless views of this height and width can be rendered by so many processes."""
    if importlib.util.find_spec("embreex") is None:  # there are no wheels of it for Linux on ARM
        raise SceneError("to build rooms, embreex is missing: pip install embreex")
    if not (min(size) >= 8 and max(size) <= 4096):
        raise SceneError(f"size={list(size)}: views are 8 to 4096 pixels high and wide")
    if workers is not None and workers < 1:
        raise SceneError(f"workers={workers}: at least one process is needed")


def write_room(
    out: Path,
    room: RoomDescription,
    way: Walk,
    views: Sequence["View"],
    encoder: "ViewEncoder | None",
    attributes: dict[str, Any],
    *,
    source: str = "synthetic",
    progress: bool = False,
    looks: Sequence[Sequence[Array]] = (),
) -> list[str]:
    """Encode the stored views of a room, write its dump, completely or not at all, and tell the problems found.

    Of ``looks``, the views of each further look, uint8 ``[height, width, 3]`` each, only features are stored.
    """
    scene = scene_of(room, way, source=source)
    about, about_patches = {"extractor": "none"}, dict[str, str]()
    if encoder is not None:
        from dirl.perception.backbones import encode_all

        shown = [(decode(view.encoded) for view in views), *map(iter, looks)]
        found, *again = (encode_all(encoder, images, len(scene), str(out), progress=progress) for images in shown)
        features = found.features.astype(np.float16)
        scene = replace(scene, features=features, extractor=encoder.extractor, patches=found.patches)
        if again:
            look_features = np.stack([one.features.astype(np.float16) for one in again])
            parts = None if found.patches is None else np.stack([np.asarray(one.patches) for one in again])
            scene = replace(scene, look_features=look_features, look_patches=parts)
        about = dict(encoder.attributes)
        about_patches = dict(encoder.patch_attributes) if found.patches is not None else {}
    write_dump(
        out,
        scene,
        (view.encoded for view in views),
        attributes={"room": description_text(room), "step": room.grid.step, **attributes},
        feature_attributes=about,
        patch_attributes=about_patches,
    )
    return check_room(room) + view_problems(views, way)


def scene_of(room: RoomDescription, way: Walk, *, source: str = "synthetic") -> Scene:
    """Return the scene of a room, without features and views."""
    turns = len(way.headings)
    return Scene(
        name=room.name,
        graph=way.graph,
        positions=np.repeat(way.places, turns, axis=0),
        headings=np.tile(way.headings, len(way.places)),
        goals=tuple(goal * turns // 4 for goal in room.goals),
        source=source,
        extractor="none",
        origin=f"the room '{room.name}'",
    )


def poses(way: Walk) -> list[Pose]:
    """Return where the camera of each state is and looks."""
    return [(float(x), float(y), float(heading)) for x, y in way.places for heading in way.headings]


def view_problems(views: Sequence["View"], way: Walk) -> list[str]:
    """Return what `check_views` finds in views."""
    return check_views(np.stack([v.thumbnail for v in views]), np.array([v.contrast for v in views]), way)


PIXELS = 2_000_000
"""Of views that are rendered in the time that it takes to start another process."""


@dataclass(frozen=True)
class View:
    """A stored view, and what the checks need of it."""

    encoded: bytes
    thumbnail: Array
    contrast: float


def take_views(
    renderer: Renderer,
    camera: Camera,
    poses: list[Pose],
    size: tuple[int, int],
    quality: int = QUALITY,
    workers: int | None = 1,
    progress: bool = True,
) -> Iterator[View]:
    """The views from all poses, in their order, rendered by several processes; ``size`` is height and width in pixels.

    If ``workers`` is None there is one for each `PIXELS` of all views together, at most one for each core.
    """
    take = partial(_take, renderer, camera, size, quality)
    if workers is None:
        workers = min(1 + size[0] * size[1] * len(poses) // PIXELS, os.cpu_count() or 1)
    workers = min(workers, len(poses))
    with ExitStack() as stack:
        views: Iterator[View] = map(take, poses)
        if workers > 1:
            # Started anew rather than forked: the same on every system, and safe beside the threads of torch.
            pool = stack.enter_context(ProcessPoolExecutor(workers, get_context("spawn"), _start, (take,)))
            views = pool.map(_take_here, poses, chunksize=4)
        yield from tqdm(views, "views", len(poses), unit=" views", disable=None if progress else True)


def _take(renderer: Renderer, camera: Camera, size: tuple[int, int], quality: int, pose: Pose) -> View:
    view = renderer.view(camera, pose, size)
    return View(encode(view, quality), thumbnail(view), contrast(view))


_TAKE: list[Callable[[Pose], View]] = []
"""In a process that takes views: `_take` with its first arguments, which are too large to be sent with every pose."""


def _start(take: Callable[[Pose], View]) -> None:
    _TAKE.append(take)


def _take_here(pose: Pose) -> View:
    return _TAKE[0](pose)
