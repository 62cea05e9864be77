"""Shapes as triangles: boxes, turned and lofted bodies, tubes, sheets."""

import inspect
import types
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

Array = np.ndarray


@dataclass(frozen=True)
class Part:
    """Triangles of one material.

    Args:
        corners: metres, float64 ``[n, 3 corners, 3]``, anticlockwise seen from outside.
        uv: where in the texture each corner is, float64 ``[n, 3, 2]``; None until it is known how large a repeat is.
        material: its name.
        smooth: degrees up to which triangles that share a corner look rounded.
        unturned: ``corners`` before the part was moved. Normals are computed from these and turned with the part, so
            that the same piece is shaded alike, to the last bit, however it stands.
        turn: how it was turned, a rotation matrix ``[3, 3]``.
    """

    corners: Array
    uv: Array | None
    material: str
    smooth: float
    unturned: Array
    turn: Array

    @property
    def normals(self) -> Array:
        """At the corners, of length 1, float64 ``[n, 3, 3]``; computed here, as most parts are only measured."""
        return corner_normals(self.unturned, self.smooth) @ self.turn

    def moved(self, at: ArrayLike, yaw: float, texture_size: float, *, grained: bool = False) -> "Part":
        """Return the part turned anticlockwise by ``yaw`` degrees about the z axis, then shifted by ``at`` ``[3]``.

        Where the texture lies is fixed beforehand, so that it turns with the part; ``grained`` ones run along it.
        """
        c, s = np.cos(np.radians(yaw)), np.sin(np.radians(yaw))
        turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        uv = _box_projection(self.corners, texture_size, grained) if self.uv is None else self.uv
        return Part(self.corners @ turn + np.asarray(at), uv, self.material, self.smooth, self.corners, turn)


def _box_projection(corners: Array, texture_size: float, grained: bool) -> Array:
    """Return metres over the repeat's size along the two axes a triangle faces least; the longer first if grained."""
    facing = np.abs(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])).argmax(1)
    pairs = np.array([[1, 2], [0, 2], [0, 1]])
    if grained:
        extent = np.ptp(corners.reshape(-1, 3), axis=0)
        pairs = np.array([sorted(pair, key=lambda axis: -extent[axis]) for pair in pairs])
    axes = pairs[facing]
    return np.take_along_axis(corners, np.repeat(axes[:, None], 3, 1), 2) / (texture_size or 1.0)


def corner_normals(corners: Array, angle: float) -> Array:
    """Return means, by area, over triangles that share a corner and face within ``angle`` degrees of each other."""
    faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    directions = faces / np.maximum(np.linalg.norm(faces, axis=1, keepdims=True), 1e-12)
    keys = np.round(corners.reshape(-1, 3) * 1e5).astype(np.int64)
    point = np.unique(keys, axis=0, return_inverse=True)[1].ravel()
    order = np.argsort(point, kind="stable")
    face = order // 3
    starts = np.flatnonzero(np.r_[True, np.diff(point[order]) != 0])
    counts = np.diff(np.r_[starts, len(order)])
    start, count = np.repeat(starts, counts), np.repeat(counts, counts)
    total = np.zeros((len(order), 3))
    for k in range(counts.max()):
        others = np.flatnonzero(count > k)
        other = face[start[others] + k]
        alike = (directions[face[others]] * directions[other]).sum(1) >= np.cos(np.radians(angle))
        total[others] += faces[other] * alike[:, None]
    normals = np.empty_like(total)
    normals[order] = total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)
    return normals.reshape(-1, 3, 3)


def _triangles(points: Array) -> Array:
    """Return two triangles for every cell of a ``[rows, columns, k]`` grid of points."""
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]
    both = np.stack([np.stack([a, b, c], -2), np.stack([a, c, d], -2)], 2)
    return both.reshape(-1, 3, points.shape[-1])


def fan(centre: Array, ring: Array) -> Array:
    """Return triangles from a centre to a closed ring ``[n + 1, 3]``, facing along the ring's axis reversed."""
    return np.stack([np.broadcast_to(centre, ring[:-1].shape), ring[1:], ring[:-1]], 1)


class Mesh:
    """A body under construction, in its own coordinates. Every method returns the mesh, so that calls chain."""

    def __init__(self) -> None:
        self.parts: list[Part] = []

    def add(self, corners: ArrayLike, material: str, uv: ArrayLike | None = None, *, smooth: float = 45.0) -> Self:
        """Add triangles, ``[n, 3, 3]``; those that share a corner look rounded up to ``smooth`` degrees."""
        points = np.asarray(corners, float)
        area = np.linalg.norm(np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]), axis=1)
        points, wanted = points[area > 1e-10], None if uv is None else np.asarray(uv, float)[area > 1e-10]
        self.parts.append(Part(points, wanted, material, smooth, points, np.eye(3)))
        return self

    def box(
        self, x0: float, y0: float, z0: float, x1: float, y1: float, z1: float, material: str, bevel: float = 0.008
    ) -> Self:
        """Add a box from corner to corner, its edges cut off by ``bevel`` metres (less where the box is thin)."""
        low, high = np.array([x0, y0, z0]), np.array([x1, y1, z1])
        bevel = min(bevel, 0.45 * (high - low).min())
        signs, inset = _box_corners(bool(bevel))
        points = np.where(signs > 0, high, low) - signs * (inset * bevel)
        outwards = points.mean(1) - (low + high) / 2
        inverted = (np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]) * outwards).sum(1) < 0
        points[inverted] = points[inverted][:, ::-1]
        return self.add(points, material, smooth=50.0 if bevel else 1.0)

    def loft(
        self,
        rings: Sequence[tuple[float, ...]],
        material: str,
        *,
        at: tuple[float, float] = (0.0, 0.0),
        exponent: float = 2.0,
        sides: int = 48,
        bottom: bool = True,
        smooth: float = 45.0,
    ) -> Self:
        """Add a body through rings ``(z, rx, ry[, exponent[, dx, dy]])``, as on a lathe; it may turn back in itself.

        Rings are superellipses: exponent 2 is an ellipse, more is squarer. ``dx, dy`` is a ring's offset from ``at``.
        """
        angle = np.linspace(0, 2 * np.pi, sides + 1)
        cos, sin = np.cos(angle), np.sin(angle)
        points = np.empty((len(rings), sides + 1, 3))
        for ring, (z, rx, ry, *rest) in zip(points, rings, strict=True):
            power = 2 / (rest[0] if rest else exponent)
            dx, dy = rest[1:] if len(rest) > 1 else (0.0, 0.0)
            ring[:, 0] = rx * np.sign(cos) * np.abs(cos) ** power + at[0] + dx
            ring[:, 1] = ry * np.sign(sin) * np.abs(sin) ** power + at[1] + dy
            ring[:, 2] = z
        lower = [fan(points[0, :-1].mean(0), points[0])] if bottom else []
        upper = fan(points[-1, :-1].mean(0), points[-1])[:, ::-1]
        return self.add(np.concatenate([_triangles(points), *lower, upper]), material, smooth=smooth)

    def cylinder(self, x: float, y: float, z0: float, z1: float, radius: float, material: str, sides: int = 28) -> Self:
        """Add an upright cylinder."""
        return self.loft([(z0, radius, radius), (z1, radius, radius)], material, at=(x, y), sides=sides)

    def ball(self, x: float, y: float, z: float, radius: float, material: str, sides: int = 16) -> Self:
        """Add a sphere."""
        angles = np.linspace(-np.pi / 2, np.pi / 2, sides // 2 + 1)
        rings = [(z + radius * np.sin(a), *2 * (max(radius * np.cos(a), 1e-4),)) for a in angles]
        return self.loft(rings, material, at=(x, y), sides=sides, smooth=90)

    def tube(self, path: ArrayLike, radius: float, material: str, sides: int = 12) -> Self:
        """Add a round bar along a path of points ``[n, 3]``, closed at both ends."""
        points = np.asarray(path, float)
        along = np.gradient(points, axis=0)
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        upright = np.abs(along[:, 2]).max() >= 0.9
        across = np.cross(along, [0.31, 0.95, 0.05] if upright else [0.0, 0.0, 1.0])
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        other = np.cross(along, across)
        angle = np.linspace(0, 2 * np.pi, sides + 1)[None, :, None]
        rings = points[:, None] + radius * (np.cos(angle) * across[:, None] + np.sin(angle) * other[:, None])
        ends = [fan(points[0], rings[0]), fan(points[-1], rings[-1])[:, ::-1]]
        return self.add(np.concatenate([_triangles(rings), *ends]), material)

    def quad(self, corners: ArrayLike, material: str, *, image: bool = False) -> Self:
        """Add a flat rectangle, corners anticlockwise from the lower left; an ``image`` shows all of the texture."""
        points, whole = np.asarray(corners, float), np.array([(0, 1), (1, 1), (1, 0), (0, 0)], float)
        split = [[0, 1, 2], [0, 2, 3]]
        return self.add(points[split], material, whole[split] if image else None, smooth=1.0)

    def sheet(
        self, surface: Callable[[Array, Array], Array], columns: int, rows: int, material: str, *, image: bool = True
    ) -> Self:
        """Add a curved surface: ``surface(u, v)`` maps ``[rows, columns]`` numbers in [0, 1] to points ``[..., 3]``."""
        v, u = np.meshgrid(np.linspace(0, 1, rows), np.linspace(0, 1, columns), indexing="ij")
        uv = _triangles(np.stack([u, 1 - v], -1)) if image else None
        return self.add(_triangles(surface(u, v)), material, uv, smooth=80.0)


@cache
def _box_corners(beveled: bool) -> tuple[Array, Array]:
    """Return a box's triangle corners: on which side of the box, -1 or 1, and where inset; int ``[n, 3, 3]`` each."""
    sides, quads, triangles = (-1, 1), [], []
    for axis in range(3):
        a, b = (other for other in range(3) if other != axis)
        around = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
        for side in sides:
            quads.append([({axis: side, a: p, b: q}, axis) for p, q in around])
        for p, q in product(sides, sides) if beveled else ():
            ends = [(-1, a), (1, a), (1, b), (-1, b)]
            quads.append([({axis: end, a: p, b: q}, face) for end, face in ends])
    if beveled:
        triangles = [[(dict(enumerate(sign)), axis) for axis in range(3)] for sign in product(sides, sides, sides)]
    triangles += [[quad[i] for i in pick] for quad in quads for pick in ((0, 1, 2), (0, 2, 3))]
    signs = np.array([[[sign[axis] for axis in range(3)] for sign, _ in triangle] for triangle in triangles])
    # The corner of the face across an axis that lies nearest to a corner of the box.
    inset = np.array([[[other != axis for other in range(3)] for _, axis in triangle] for triangle in triangles])
    return signs, inset.astype(int)


def functions_of(*modules: types.ModuleType) -> dict[str, Callable[..., Any]]:
    """Return the public functions that modules define, as kinds of furniture or of textures, by their names."""
    return {
        name: function
        for module in modules
        for name, function in vars(module).items()
        if inspect.isfunction(function) and function.__module__ == module.__name__ and not name.startswith("_")
    }
