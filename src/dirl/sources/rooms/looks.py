"""Further looks of a room: what its states look like at visits that differ a little from the planned ones."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dirl.scenes import SceneError
from dirl.scenes.views import decode, encode
from dirl.sources.rooms.build import QUALITY, poses
from dirl.sources.rooms.description import Camera
from dirl.sources.rooms.mesh import Array
from dirl.sources.rooms.navigation import Walk
from dirl.sources.rooms.view import Renderer

LARGEST = {"position": 1.0, "heading": 45.0, "exposure": 1.0}
"""What a visit can be off."""


@dataclass(frozen=True)
class Changes:
    """By how much a visit differs from the planned one: standard deviations of normal distributions.

    Args:
        position: of the camera along each axis of the floor, metres.
        heading: degrees.
        exposure: of the logarithm of the brightness; 0.05 is about 5 %.

    Raises:
        SceneError: a negative one, or one beyond what a visit can be called.
    """

    position: float = 0.05
    heading: float = 5.0
    exposure: float = 0.15

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0 <= value <= LARGEST[name]:
                raise SceneError(f"changes.{name}={value:g}: must be 0 to {LARGEST[name]:g}")


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
