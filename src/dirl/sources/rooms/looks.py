"""Further looks of a room: what its states look like at visits that differ a little from the planned ones."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from dirl.scenes import SceneError
from dirl.scenes.views import decode, encode
from dirl.sources.rooms.build import QUALITY, poses
from dirl.sources.rooms.description import Camera
from dirl.sources.rooms.mesh import Array
from dirl.sources.rooms.navigation import Walk
from dirl.sources.rooms.view import Renderer

LARGEST_HEADING = 45.0
"""Degrees that a visit can be off; of all other errors 1 is the largest."""


@dataclass(frozen=True)
class Changes:
    """By how much a visit differs from the planned one: standard deviations of normal distributions.

    Args:
        position: of the camera along each axis of the floor, metres.
        heading: degrees.
        exposure: of the logarithm of the brightness; 0.05 is about 5 %.
        white_balance: of the logarithm of red and of blue.
        camera_height: metres.
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
    vary: float = 0.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0 <= value <= _largest(name):
                raise SceneError(f"changes.{name}={value:g}: must be 0 to {_largest(name):g}")

    def times(self, factor: float) -> "Changes":
        """Return all errors times a factor, at most the largest."""
        return replace(self, **{name: min(_largest(name), factor * value) for name, value in vars(self).items()})


def _largest(name: str) -> float:
    return LARGEST_HEADING if name == "heading" else 1.0


def look_views(
    renderer: Renderer, camera: Camera, way: Walk, size: tuple[int, int], changes: Changes, seed: int
) -> Iterator[Array]:
    """Yield the views of one look, uint8 ``[height, width, 3]``, in the order of the states, as they would be stored.

    The error of a visit is sampled once for each place: all views from there share it, as those of a robot that turns
    on the spot do.
    """
    rng = np.random.default_rng(seed)
    turns, places = len(way.headings), len(way.places)
    if changes.vary:
        changes = changes.times(float(rng.uniform(1 - changes.vary, 1 + changes.vary)))
    moved = rng.normal(0, 1, (places, 2)) * changes.position
    turned, raised = rng.normal(0, 1, (2, places)) * [[changes.heading], [changes.camera_height]]
    brightness = np.exp(rng.normal(0, 1, places) * changes.exposure)
    tint = np.exp(rng.normal(0, 1, (places, 2)) * changes.white_balance)
    for state, (x, y, heading) in enumerate(poses(way)):
        place = state // turns
        seen = Renderer(renderer.scenery, renderer.light, renderer.exposure * float(brightness[place]))
        pose = (x + moved[place, 0], y + moved[place, 1], heading + turned[place])
        view = seen.view(replace(camera, height=camera.height + float(raised[place])), pose, size)
        if changes.white_balance:
            gains = np.array([tint[place, 0], 1.0, tint[place, 1]])
            view = np.clip(view * gains, 0, 255).astype(np.uint8)
        yield decode(encode(view, QUALITY))
