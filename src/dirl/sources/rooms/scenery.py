"""A room prepared for ray casting: finely divided triangles, textures at every size, and first hits."""

from typing import NamedTuple

import numpy as np

from dirl.sources.rooms.description import Material
from dirl.sources.rooms.materials import paint
from dirl.sources.rooms.mesh import Array, Part


class Hits(NamedTuple):
    """What rays met first: triangle (-1: nothing), its coordinates there, and how far away; ``[n]`` each."""

    triangle: Array
    u: Array
    v: Array
    distance: Array


class Scenery:
    """Triangles of `dirl.sources.rooms.layout.assemble`, materials and textures of one room.

    No side of a triangle is longer than ``edge`` metres, for light is known at corners. Arrays: ``corners`` and
    ``normals`` float32 ``[n, 3, 3]``, ``uv`` float32 ``[n, 3, 2]``, ``material`` int ``[n]``, ``facing`` float32
    ``[n, 3]``, ``area`` float64 ``[n]``; ``point`` int ``[n, 3]``: which of the P corners of another position or normal
    each is; ``rough``, ``emit``, ``glow``, ``metal`` and ``mirror`` of each material.
    """

    def __init__(
        self, parts: list[Part], materials: dict[str, Material], *, edge: float = 0.10, texture_limit: int = 2048
    ) -> None:
        names, number = np.unique([part.material for part in parts], return_inverse=True)
        used = [materials[name] for name in names]
        each = [(part.corners, part.normals, np.asarray(part.uv)) for part in parts]
        soup = np.concatenate([np.concatenate(arrays, -1) for arrays in each])
        material = np.repeat(number, [len(part.corners) for part in parts])
        soup, self.material = divide(soup, material, edge)
        soup = soup.astype(np.float32)
        self.corners, self.uv = np.ascontiguousarray(soup[..., :3]), np.ascontiguousarray(soup[..., 6:])
        self.normals = unit(soup[..., 3:6])
        crossed = np.cross(self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0])
        self.facing, self.area = unit(crossed), np.linalg.norm(crossed.astype(np.float64), axis=1) / 2
        self.point, self.point_corner = _distinct(self.corners, self.normals)
        self.rough, self.emit, self.glow, self.size = (
            np.array([getattr(item, key) for item in used], np.float32) for key in ("rough", "emit", "glow", "size")
        )
        self.size[self.size == 0] = 1.0
        self.metal, self.mirror = (np.array([getattr(item, key) for item in used]) for key in ("metal", "mirror"))
        self._store_textures([paint(*pair, texture_limit) for pair in zip(names, used, strict=True)])
        from embreex import mesh_construction, rtcore_scene  # here: some machines have none

        self._embree = rtcore_scene.EmbreeScene()
        mesh_construction.TriangleMesh(self._embree, self.corners)

    def trace(self, origins: Array, directions: Array) -> Hits:
        """Return the first hit of each ray; origins and directions ``[n, 3]``."""
        rays = (np.ascontiguousarray(values, np.float32) for values in (origins, directions))
        hits = self._embree.run(*rays, query="INTERSECT", output=1)
        return Hits(hits["primID"].astype(np.int64), hits["u"], hits["v"], hits["tfar"])

    def color(self, triangle: Array, u: Array, v: Array, footprint: Array | None = None) -> Array:
        """Return linear texture colour, float32 ``[n, 3]``; ``footprint`` is what a pixel covers, metres, ``[n]``."""
        material = self.material[triangle]
        mip = self._first[material]
        if footprint is not None:
            texel = self.size[material] / self._side[mip]
            level = np.round(np.log2(np.maximum(footprint / texel, 1e-6))).astype(np.int64)
            mip += np.clip(level, 0, self._last[material] - mip)
        side, start = self._side[mip], self._start[mip]
        at = interpolate(self.uv[triangle], u, v) * side[:, None] - np.float32(0.5)
        low = np.floor(at)
        share = at - low
        (x0, y0), (x1, y1) = (low.astype(np.int64).T & (side - 1)), ((low.astype(np.int64) + 1).T & (side - 1))
        fx, fy = share[:, :1], share[:, 1:]
        texels = self._texels
        above = texels[start + y0 * side + x0] * (1 - fx) + texels[start + y0 * side + x1] * fx
        below = texels[start + y1 * side + x0] * (1 - fx) + texels[start + y1 * side + x1] * fx
        return above * (1 - fy) + below * fy

    def _store_textures(self, textures: list[Array]) -> None:
        """Put all textures into one long array of texels, each at every size down to one pixel."""
        levels: list[Array] = []
        first, last = [], []
        for texture in textures:
            first.append(len(levels))
            levels.append(linear(texture).astype(np.float32))
            while len(level := levels[-1]) > 1:
                levels.append((level[::2, ::2] + level[1::2, ::2] + level[::2, 1::2] + level[1::2, 1::2]) / 4)
            last.append(len(levels) - 1)
        self._first, self._last = np.array(first), np.array(last)
        self._side = np.array([len(level) for level in levels])
        self._start = np.concatenate([[0], np.cumsum(self._side**2)[:-1]])
        self._texels = np.concatenate([level.reshape(-1, 3) for level in levels])
        self.mean_color = self._texels[self._start[self._last]]


def divide(soup: Array, material: Array, edge: float) -> tuple[Array, Array]:
    """Halve the longest sides of triangles, ``[n, 3, k]`` with the position first, until none exceeds ``edge``."""
    done = []
    while len(soup):
        lengths = np.linalg.norm(soup[:, [1, 2, 0], :3] - soup[:, :, :3], axis=2)
        longest = lengths.argmax(1)
        rows = np.arange(len(soup))
        long = lengths[rows, longest] > edge
        done.append((soup[~long], material[~long]))
        soup, material, longest = soup[long], material[long], longest[long]
        rows = rows[: len(soup)]
        a, b, c = (soup[rows, (longest + k) % 3] for k in range(3))
        middle = (a + b) / 2
        soup = np.concatenate([np.stack([a, middle, c], 1), np.stack([middle, b, c], 1)])
        material = np.concatenate([material, material])
    return np.concatenate([part for part, _ in done]), np.concatenate([part for _, part in done])


def _distinct(corners: Array, normals: Array) -> tuple[Array, Array]:
    """Return which distinct point each corner is, int32 ``[n, 3]``, and for each point one of its corners, int ``[P]``.

    Corners are one point if they lie within half a millimetre of each other and face about the same way.
    """
    key = np.zeros(corners.size // 3, np.uint64)
    for value in np.round((corners.reshape(-1, 3) + 1) * 2e3).T:  # 16 bits each: up to 32 metres
        key = (key << np.uint64(16)) | value.astype(np.uint64)
    for value in np.round((normals.reshape(-1, 3) + 1) * 8).T:
        key = (key << np.uint64(5)) | value.astype(np.uint64)
    _, corner, point = np.unique(key, return_index=True, return_inverse=True)
    return point.reshape(-1, 3).astype(np.int32), corner


def linear(srgb: Array) -> Array:
    """Return linear light from sRGB values in [0, 1]."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def unit(vectors: Array) -> Array:
    """Return vectors ``[..., 3]`` scaled to length 1."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def interpolate(values: Array, u: Array, v: Array) -> Array:
    """Return values at the corners of triangles, ``[n, 3, k]``, between them, ``[n, k]``."""
    u, v = u[:, None], v[:, None]
    return values[:, 0] * (1 - u - v) + values[:, 1] * u + values[:, 2] * v
