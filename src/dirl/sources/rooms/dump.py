"""From a description of a room to a dump file: its graph, its views and further looks of them, their features."""

import importlib.util
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from tqdm import tqdm

from dirl.scenes.io.files import check_choice
from dirl.scenes.io.write import write_dump
from dirl.scenes.scene import Scene, SceneError
from dirl.scenes.views import decode, encode
from dirl.sources.rooms.checks import check_room, check_views, contrast, thumbnail
from dirl.sources.rooms.description import Camera, RoomDescription, description_text, read_description
from dirl.sources.rooms.mesh import Array
from dirl.sources.rooms.view import Pose, Renderer
from dirl.sources.rooms.walkable import Walk, walk

if TYPE_CHECKING:  # the models are built on the scenes
    from dirl.perception.backbones import ViewEncoder

DESCRIPTIONS = Path(__file__).parent / "descriptions"
"""The built-in rooms, one TOML file each."""

QUALITY = 72
"""Quality of the stored WebP views."""


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
    check_choice(str(description), [*built_in_rooms(), "<a room>.toml"], "", "built-in room")
    return read_description(DESCRIPTIONS / f"{description}.toml")


def build_room(
    description: str | Path | RoomDescription,
    out: str | Path,
    *,
    size: tuple[int, int] = (300, 400),
    turn: float = 90,
    encoder: "ViewEncoder | None" = None,
    fine: bool = True,
) -> list[str]:
    """Light a room, render the view of every state, and write a scene dump.

    The same description gives the same file on one machine; on another machine the same graph, and views that differ by
    rounding.

    Args:
        description: a built-in room by name, a TOML file, or a description made in memory.
        out: the dump to write, completely or not at all.
        size: height and width of the views, pixels.
        turn: degrees of a turn, see `walk`.
        encoder: what makes the features, from the views as they are stored; no features if left out.
        fine: the light of the built-in rooms; otherwise a coarser one, ten times faster.

    Returns:
        The problems that `check_room` and `check_views` found, one line each.

    Raises:
        SceneError: the room cannot be made, ``out`` exists, or an argument is out of range. All this is detected
            before the long work begins.
    """
    check_arguments(size)
    room, out = describe_room(description), Path(out)
    if out.exists():
        raise SceneError(f"{out}: this file exists already; it is not overwritten")
    way = walk(room, turn)
    source = "rooms" if str(description) in built_in_rooms() else "synthetic"
    seen = take_views(Renderer.of(room, fine=fine), room.camera, poses(way), size)
    views = list(tqdm(seen, "views", len(way.graph), unit=" views", disable=None))
    return write_room(out, room, way, views, encoder, {"turn": float(turn)}, source=source, progress=True)


def check_arguments(size: tuple[int, int]) -> None:
    """Raise `SceneError` unless views of this height and width can be rendered."""
    if importlib.util.find_spec("embreex") is None:  # there are no wheels of it for Linux on ARM
        raise SceneError("to build rooms, embreex is missing: pip install embreex")
    if not (min(size) >= 8 and max(size) <= 4096):
        raise SceneError(f"size={list(size)}: views are 8 to 4096 pixels high and wide")


def write_room(
    out: Path,
    room: RoomDescription,
    way: Walk,
    views: Sequence["View"],
    encoder: "ViewEncoder | None",
    attributes: dict[str, object],
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

        shown = chain((decode(view.encoded) for view in views), *looks)
        count = (1 + len(looks)) * len(scene)
        features, patches = encode_all(encoder, shown, count, str(out), progress=progress)
        first, *further = np.split(features.astype(np.float16), 1 + len(looks))
        scene = replace(scene, features=first, extractor=encoder.extractor)
        if looks:
            scene = replace(scene, look_features=np.stack(further))
        if patches is not None:
            first, *further = np.split(patches, 1 + len(looks))
            scene = replace(scene, patches=first, look_patches=np.stack(further) if looks else None)
            about_patches = dict(encoder.patch_attributes)
        about = dict(encoder.attributes)
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


@dataclass(frozen=True)
class View:
    """A stored view, and what the checks need of it."""

    encoded: bytes
    thumbnail: Array
    contrast: float


def take_views(
    renderer: Renderer, camera: Camera, poses: Sequence[Pose], size: tuple[int, int], *, threads: int | None = None
) -> Iterator[View]:
    """Yield the views from all poses, in their order; ``size`` is height and width in pixels.

    They are rendered by as many threads as there are cores if ``threads`` is None; NumPy lets them run at once.
    """
    with ThreadPoolExecutor(threads or os.cpu_count()) as pool:
        yield from pool.map(partial(_take, renderer, camera, size), poses)


def _take(renderer: Renderer, camera: Camera, size: tuple[int, int], pose: Pose) -> View:
    view = renderer.view(camera, pose, size)
    return View(encode(view, QUALITY), thumbnail(view), contrast(view))


@dataclass(frozen=True)
class Changes:
    """By how much a visit differs from the planned one: standard deviations of normal distributions.

    Args:
        position: of the camera along each axis of the floor, metres.
        heading: degrees.
        exposure: of the logarithm of the brightness; 0.05 is about 5 %.
    """

    position: float = 0.05
    heading: float = 5.0
    exposure: float = 0.15


def look_views(
    renderer: Renderer, camera: Camera, way: Walk, size: tuple[int, int], changes: Changes, seed: int
) -> Iterator[Array]:
    """Yield the views of one look, uint8 ``[height, width, 3]``, in the order of the states, as they would be stored.

    The error of a visit is sampled once for each place: all views from there share it, as those of a robot that turns
    on the spot do.
    """
    rng = np.random.default_rng(seed)
    turns, places = len(way.headings), len(way.places)
    moved = rng.normal(0, 1, (places, 2)) * changes.position
    # The second row was the camera's height once; it is still sampled, so that a seed gives the look that it gave.
    turned = rng.normal(0, 1, (2, places))[0] * changes.heading
    brightness = np.exp(rng.normal(0, 1, places) * changes.exposure)
    for state, (x, y, heading) in enumerate(poses(way)):
        place = state // turns
        seen = Renderer(renderer.scenery, renderer.light, renderer.exposure * float(brightness[place]))
        pose = (x + moved[place, 0], y + moved[place, 1], heading + turned[place])
        yield decode(encode(seen.view(camera, pose, size), QUALITY))
