"""Camera views of a lit room: one ray for each sample, one texture look-up, one reflection where it is polished."""

from collections.abc import Callable
from typing import Self

import numpy as np

from dirl.sources.rooms.description import Camera, Material, RoomDescription, Size
from dirl.sources.rooms.layout import assemble, materials_of
from dirl.sources.rooms.light import bake
from dirl.sources.rooms.mesh import Array, Part
from dirl.sources.rooms.scenery import Scenery, interpolate, unit

SAMPLES = ((0.125, 0.625), (0.375, 0.125), (0.625, 0.875), (0.875, 0.375))
"""Where in a pixel the four rays go: a rotated grid, so that edges of any slope have soft steps."""

Pose = tuple[float, float, float]
"""Where a camera is and looks: x and y in metres, degrees clockwise from the y axis."""

MIDDLE_GREY = 0.30
"""What the mean brightness of a room is exposed to; 1 is white."""

LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)


class Renderer:
    """A room with its light, seen from anywhere in it.

    Args:
        scenery: the triangles and textures.
        light: irradiance at its points, float32 ``[P, 3]``.
        exposure: factor of the brightness.
    """

    def __init__(self, scenery: Scenery, light: Array, exposure: float = 1.0) -> None:
        self.scenery, self.light, self.exposure = scenery, light, exposure
        metal, mirror, rough = scenery.metal, scenery.mirror, scenery.rough
        # Rough metal scatters light in all directions, which the baked light gives without noise; only the rest
        # is a reflection. Under a varnish the fraction that is not reflected reaches the colour below.
        self._dull = np.where(mirror, 0, np.minimum(1, 1.6 * rough)).astype(np.float32)
        self._polish = np.where(metal | mirror, 1 - self._dull, (1 - rough) ** 2).astype(np.float32)
        self._head_on = np.where(mirror, 0.92, np.where(metal, 0.85, 0.04)).astype(np.float32)
        self._shines = mirror | (rough < 0.5)

    @classmethod
    def of(cls, room: RoomDescription, *, fine: bool = True) -> Self:
        """Make, light and expose a room; not ``fine`` is ten times faster, for a first look.

        Raises:
            SceneError: something in the room cannot be made.
        """
        return cls.lit(assemble(room), materials_of(room), room.size, room.camera.height, fine=fine)

    @classmethod
    def lit(
        cls, parts: list[Part], materials: dict[str, Material], size: Size, height: float, *, fine: bool = True
    ) -> Self:
        """Light and expose what is assembled already; ``size`` and ``height``, of the camera, see `exposure`."""
        scenery = Scenery(parts, materials) if fine else Scenery(parts, materials, edge=0.25, texture_limit=128)
        light = bake(scenery) if fine else bake(scenery, direct=9, indirect=36, bounces=3)
        renderer = cls(scenery, light)
        renderer.exposure = exposure(renderer, size, height)
        return renderer

    def view(self, camera: Camera, pose: Pose, size: tuple[int, int]) -> Array:
        """Return the view from a pose, uint8 ``[height, width, 3]``; ``size`` is height and width in pixels."""
        (x, y, heading), (height, width) = pose, size
        half = np.tan(np.radians(camera.fov / 2))
        turn, pitch = np.radians(heading), np.radians(camera.pitch)
        flat = np.array([np.sin(turn), np.cos(turn), 0])
        ahead = flat * np.cos(pitch) + [0, 0, np.sin(pitch)]
        right = np.array([flat[1], -flat[0], 0])
        up = np.cross(right, ahead)

        def way(across: Array, down: Array) -> Array:
            return ahead + across[None, :, None] * half * right - down[:, None, None] * half * height / width * up

        return self._picture((x, y, camera.height), size, way, 1.4 * half / width)

    def panorama(self, height: float, pose: Pose, size: tuple[int, int]) -> Array:
        """Return all directions from a place as an equirectangular image, uint8 ``[height, width, 3]``.

        Columns are degrees clockwise from the pose's heading, -180 to 180; rows are degrees up, 90 to -90. The camera
        is so many metres above the floor; ``size`` is the height and width of the image.
        """
        x, y, heading = pose

        def way(across: Array, down: Array) -> Array:
            turn, pitch = np.radians(heading) + np.pi * across[None, :], -np.pi / 2 * down[:, None]
            flat = np.cos(pitch)
            return np.stack(np.broadcast_arrays(flat * np.sin(turn), flat * np.cos(turn), np.sin(pitch)), -1)

        return self._picture((x, y, height), size, way, 2 * np.pi / size[1])

    def _picture(
        self, origin: tuple[float, float, float], size: tuple[int, int], way: Callable[..., Array], spread: float
    ) -> Array:
        """Render the view of a point; ``way`` maps columns and rows, -1 to 1, to directions ``[height, width, 3]``."""
        height, width = size
        origins = np.broadcast_to(np.array(origin, np.float32), (height * width, 3))
        total = np.zeros((height * width, 3), np.float32)
        for dx, dy in SAMPLES:
            ways = way((np.arange(width) + dx) / width * 2 - 1, (np.arange(height) + dy) / height * 2 - 1)
            seen = self.radiance(origins, unit(ways.reshape(-1, 3)).astype(np.float32), spread, reflect=True)
            total += np.minimum(seen * self.exposure, 4.0)  # one bright sample must not outshine the other three
        return display(total.reshape(height, width, 3) / len(SAMPLES))

    def radiance(self, origins: Array, way: Array, spread: float, *, reflect: bool) -> Array:
        """Return the radiance along rays, linear, float32 ``[n, 3]``; black where a ray meets nothing.

        Args:
            origins: ``[n, 3]``.
            way: of length 1, ``[n, 3]``.
            spread: metres that a ray widens on each metre; textures are averaged over as much.
            reflect: whether polished surfaces show what they reflect.
        """
        scenery = self.scenery
        hits = scenery.trace(origins, way)
        lost = hits.triangle < 0
        triangle = np.where(lost, 0, hits.triangle)
        material = scenery.material[triangle]
        slant = np.maximum(np.abs((scenery.facing[triangle] * way).sum(1)), 0.15)
        base = scenery.color(triangle, hits.u, hits.v, hits.distance * spread / np.sqrt(slant))
        out = base * interpolate(self.light[scenery.point[triangle]], hits.u, hits.v)
        lamp = scenery.emit[material] > 0
        out[lamp] = base[lamp] * (scenery.glow[material[lamp]] / self.exposure)[:, None]
        out[lost] = 0
        shiny = np.flatnonzero(self._shines[material] & ~lamp & ~lost) if reflect else ()
        if len(shiny):
            kind, incoming = material[shiny], way[shiny]
            normal = unit(interpolate(scenery.normals[triangle[shiny]], hits.u[shiny], hits.v[shiny]))
            cos = -(normal * incoming).sum(1)
            normal, cos = normal * np.sign(cos)[:, None], np.abs(cos)
            start = origins[shiny] + incoming * hits.distance[shiny, None] + 2e-3 * normal
            seen = self.radiance(start, unit(incoming + 2 * cos[:, None] * normal), 2 * spread, reflect=False)
            seen = np.minimum(seen, 1.6 / self.exposure)
            head_on = self._head_on[kind]
            share = (head_on + (1 - head_on) * (1 - cos) ** 5) * self._polish[kind]
            bare = scenery.metal[kind] | scenery.mirror[kind]
            below = np.where(bare, self._dull[kind], 1 - share)
            tint = np.where(bare[:, None], base[shiny], 1)
            out[shiny] = out[shiny] * below[:, None] + seen * tint * share[:, None]
        return out


def exposure(renderer: Renderer, size: Size, height: float) -> float:
    """Return what makes the mean brightness of rays from all over a room `MIDDLE_GREY`; ``height`` is the camera's.

    It has three digits, so that the last bit of a sum, which differs between machines, does not show.
    """
    rng = np.random.default_rng(0)
    middle = np.array([size[0], size[1], 0])
    origins = rng.uniform(0.2, 0.8, (4096, 3)) * middle + [0, 0, height]
    way = unit(rng.normal(size=(4096, 3)) * [1, 1, 0.5]).astype(np.float32)
    brightness = np.sort(renderer.radiance(origins.astype(np.float32), way, 0.01, reflect=False) @ LUMINANCE)
    return float(f"{MIDDLE_GREY / max(float(brightness[410:-410].mean()), 1e-6):.3g}")


def display(light: Array) -> Array:
    """Return linear light as sRGB, uint8; values above white are compressed smoothly."""
    bent = np.clip(1.05 * light / (1 + 0.22 * light), 0, 1)
    srgb = np.where(bent <= 0.0031308, 12.92 * bent, 1.055 * bent ** (1 / 2.4) - 0.055)
    return (srgb * 255 + 0.5).astype(np.uint8)
