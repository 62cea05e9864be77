"""Further looks of a room: what its states look like at visits that differ a little from the planned ones."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from dirl.rooms.build import QUALITY, poses
from dirl.rooms.changed import changed_room
from dirl.rooms.description import RoomDescription
from dirl.rooms.mesh import Array
from dirl.rooms.navigation import Walk
from dirl.rooms.view import Renderer
from dirl.scenes import SceneError
from dirl.scenes.views import decode, encode

LARGEST = {"heading": 45.0, "daylight": 3.0}
"""What a visit can be called; 1 for what is not named here."""

OF_ROOM = ("lamps", "daylight", "furniture", "objects")
"""What is sampled once for a look, not for each of its visits; see `dirl.rooms.changed.changed_room`."""


@dataclass(frozen=True)
class Changes:
    """By how much a visit differs from the planned one: standard deviations of normal distributions.

    Args:
        position: of the camera along each axis of the floor, metres.
        heading: degrees.
        exposure: of the logarithm of the brightness; 0.05 is about 5 %.
        white_balance: of the logarithm of red and of blue.
        camera_height: metres.
        lamps: probability that the lamps of one kind are off; of this and the next three see
            `dirl.rooms.changed.changed_room`.
        daylight: of the logarithm of the light through each window.
        furniture: of how far a chair or the like is moved along each axis, metres.
        objects: probability that a small thing is gone.
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
    quality: int = QUALITY,
    *,
    fine: bool = True,
) -> Iterator[Array]:
    """The views of one look, uint8 ``[height, width, 3]``, in the order of the states, as they would be stored.

    The error of a visit is sampled once for each place: all views from there share it, as those of a robot that turns
    on the spot do.

    Args:
        renderer: of the room as it is.
        room: and how the agent looks.
        way: the places and headings.
        size: height and width of the views, pixels.
        changes: how large the errors are.
        seed: of the errors; another one for each look.
        quality: of the views' WebP encoding.
        fine: see `Renderer.of`, of a room that is changed.
    """
    rng = np.random.default_rng(seed)
    if changes.vary:
        changes = changes.times(float(rng.uniform(1 - changes.vary, 1 + changes.vary)))
    of_room = {name: getattr(changes, name) for name in OF_ROOM}
    if any(of_room.values()):
        renderer = Renderer.of(changed_room(room, np.random.default_rng((seed, 1)), **of_room), fine=fine)
    turns, places = len(way.headings), len(way.places)
    moved = rng.normal(0, 1, (places, 2)) * changes.position
    turned, raised = rng.normal(0, 1, (2, places)) * [[changes.heading], [changes.camera_height]]
    brightness = np.exp(rng.normal(0, 1, places) * changes.exposure)
    tint = np.exp(rng.normal(0, 1, (places, 2)) * changes.white_balance)
    for state, (x, y, heading) in enumerate(poses(way)):
        place = state // turns
        seen = Renderer(renderer.scenery, renderer.light, renderer.exposure * float(brightness[place]))
        lifted = replace(room.camera, height=room.camera.height + float(raised[place]))
        pose = (x + moved[place, 0], y + moved[place, 1], heading + turned[place])
        view = seen.view(lifted, pose, size)
        if changes.white_balance:
            gains = np.array([tint[place, 0], 1.0, tint[place, 1]])
            view = np.clip(view * gains, 0, 255).astype(np.uint8)
        yield decode(encode(view, quality))
