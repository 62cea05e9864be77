"""Further looks of a room: what its states look like at visits that differ a little from the planned ones.

The room itself may differ too: lamps off, another daylight, chairs elsewhere, small things gone.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from dirl.scenes import SceneError
from dirl.scenes.views import decode, encode
from dirl.sources.rooms.build import QUALITY, poses
from dirl.sources.rooms.checks import check_room
from dirl.sources.rooms.description import Material, Piece, RoomDescription
from dirl.sources.rooms.layout import materials_of
from dirl.sources.rooms.mesh import Array
from dirl.sources.rooms.navigation import Walk, walk
from dirl.sources.rooms.view import Renderer

LARGEST = {"heading": 45.0, "daylight": 3.0}
"""What a visit can be called; 1 for what is not named here."""

LAMPS = ("lamp", "lampshade")
"""Materials that glow in a lamp that is on."""

DARK = "#595959"
"""How a lamp that is off looks to the camera: grey, where #ffffff is white."""

MOVABLE = ("chair", "stool", "basket", "plant", "round_table")
THINGS = ("bottles", "bowl", "vase", "basket", "plant", "picture")

ATTEMPTS = 8
"""To move a piece of furniture, each half as far as the one before."""


@dataclass(frozen=True)
class Changes:
    """By how much a visit differs from the planned one: standard deviations of normal distributions.

    Args:
        position: of the camera along each axis of the floor, metres.
        heading: degrees.
        exposure: of the logarithm of the brightness; 0.05 is about 5 %.
        white_balance: of the logarithm of red and of blue.
        camera_height: metres.
        lamps: probability that the lamps of one kind, on the ceiling or with shades, are off; this and the next three
            are sampled once for a look, not for each of its visits.
        daylight: of the logarithm of the light through each window: cloud, and sun on another side.
        furniture: of how far a chair, stool, basket, plant or small round table is moved along each axis, metres, and
            of its turn, in units of 45 degrees a metre. What would stand in the way stays.
        objects: probability that a small thing, such as a vase or a picture, is gone.
        vary: each look has all of these times a factor sampled from ``1 - vary`` to ``1 + vary``, for rooms to train
            in.

    Raises:
        SceneError: a negative one, or one beyond what a visit can be called.
    """

    position: float = 0.05
    heading: float = 5.0
    exposure: float = 0.15
    white_balance: float = 0.0
    camera_height: float = 0.0
    lamps: float = 0.0
    daylight: float = 0.0
    furniture: float = 0.0
    objects: float = 0.0
    vary: float = 0.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0 <= value <= LARGEST.get(name, 1.0):
                raise SceneError(f"changes.{name}={value:g}: must be 0 to {LARGEST.get(name, 1.0):g}")

    def times(self, factor: float) -> "Changes":
        """All errors times a factor, at most the largest."""
        return replace(
            self, **{name: min(LARGEST.get(name, 1.0), factor * value) for name, value in vars(self).items()}
        )


def look_views(
    renderer: Renderer,
    room: RoomDescription,
    way: Walk,
    size: tuple[int, int],
    changes: Changes,
    seed: int,
    *,
    fine: bool = True,
) -> Iterator[Array]:
    """The views of one look, uint8 ``[height, width, 3]``, in the order of the states, as they would be stored.

    The error of a visit is sampled once for each place: all views from there share it, as those of a robot that turns
    on the spot do. ``fine`` is the light of a room that is changed, see `Renderer.of`.
    """
    rng = np.random.default_rng(seed)
    turns, places = len(way.headings), len(way.places)
    if changes.vary:
        changes = changes.times(float(rng.uniform(1 - changes.vary, 1 + changes.vary)))
    if changes.lamps or changes.daylight or changes.furniture or changes.objects:
        renderer = Renderer.of(changed_room(room, np.random.default_rng((seed, 1)), changes), fine=fine)
    moved = rng.normal(0, 1, (places, 2)) * changes.position
    turned, raised = rng.normal(0, 1, (2, places)) * [[changes.heading], [changes.camera_height]]
    brightness = np.exp(rng.normal(0, 1, places) * changes.exposure)
    tint = np.exp(rng.normal(0, 1, (places, 2)) * changes.white_balance)
    for state, (x, y, heading) in enumerate(poses(way)):
        place = state // turns
        seen = Renderer(renderer.scenery, renderer.light, renderer.exposure * float(brightness[place]))
        camera = replace(room.camera, height=room.camera.height + float(raised[place]))
        view = seen.view(camera, (x + moved[place, 0], y + moved[place, 1], heading + turned[place]), size)
        if changes.white_balance:
            gains = np.array([tint[place, 0], 1.0, tint[place, 1]])
            view = np.clip(view * gains, 0, 255).astype(np.uint8)
        yield decode(encode(view, QUALITY))


def changed_room(room: RoomDescription, rng: np.random.Generator, changes: Changes) -> RoomDescription:
    """The room at a later visit, with the same places to stand at: its lamps, daylight, furniture and objects."""
    kept = [piece for piece in room.furniture if piece.kind not in THINGS or rng.random() >= changes.objects]
    grid = replace(room.grid, places=None)  # where a thing is gone there may be more
    changed = replace(room, furniture=tuple(kept), materials=_relit(room, rng, changes), grid=grid)
    if changes.furniture:
        places = _places(room)
        for number, piece in enumerate(kept):
            if piece.kind in MOVABLE and not piece.lift:
                changed = _moved(changed, number, rng.normal(0, changes.furniture, 3), places)
    return changed


def _relit(room: RoomDescription, rng: np.random.Generator, changes: Changes) -> Mapping[str, Material]:
    known = materials_of(room)
    outlooks = {str(piece.options.get("outlook", "outdoors")) for piece in room.furniture if piece.kind == "window"}
    made = dict(room.materials)
    for name in sorted(outlooks):
        factor = float(np.exp(rng.normal(0, 1) * changes.daylight))
        if changes.daylight:
            made[name] = replace(known[name], emit=known[name].emit * factor, glow=known[name].glow * min(1.0, factor))
    for name in LAMPS:
        off = rng.random() < changes.lamps
        if off and outlooks:  # a room without a window keeps its only light
            made[name] = replace(known[name], emit=0.0, options={**known[name].options, "color": DARK})
    return made


def _moved(room: RoomDescription, number: int, errors: np.ndarray, places: set[tuple[float, ...]]) -> RoomDescription:
    """The room with one piece moved and turned, as far as it leaves the places free and touches nothing anew."""
    problems = set(check_room(room))
    for attempt in range(ATTEMPTS):
        pieces = list(room.furniture)
        pieces[number] = _shifted(pieces[number], *(float(error) for error in errors / 2**attempt))
        moved = replace(room, furniture=tuple(pieces))
        if places <= _places(moved) and set(check_room(moved)) <= problems:
            return moved
    return room


def _places(room: RoomDescription) -> set[tuple[float, ...]]:
    return {tuple(place) for place in walk(room).places.tolist()}


def _shifted(piece: Piece, along: float, across: float, turn: float) -> Piece:
    yaw = piece.yaw + 45 * turn
    if piece.at is not None:
        # A negative coordinate is measured from the far wall.
        moved = zip(piece.at, (along, across), strict=True)
        x, y = (max(0.0, v + e) if v >= 0 else min(-1e-3, v + e) for v, e in moved)
        return replace(piece, at=(x, y), yaw=yaw)
    assert piece.along is not None
    return replace(piece, along=piece.along + along, off=max(0.0, piece.off + across), yaw=yaw)
