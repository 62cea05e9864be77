"""The light of a room, computed once for all its views: the irradiance at every corner of its triangles.

Light is stored as irradiance, so that a diffuse surface of colour c emits c times it. Radiance L from all around is
an irradiance of pi L.
"""

import numpy as np

from dirl.sources.rooms.mesh import Array
from dirl.sources.rooms.scenery import Scenery, interpolate, unit


def bake(scenery: Scenery, *, direct: int = 36, indirect: int = 100, bounces: int = 4) -> Array:
    """Return the irradiance at each of the P points of a scenery, float32 ``[P, 3]``.

    So many rays go ``direct`` from each point to each material that emits light, and ``indirect`` into the room, a
    square number; these serve all bounces.
    """
    rng = np.random.default_rng(0)
    origins, normals = standpoints(scenery)
    light = direct_light(scenery, origins, normals, direct, rng)
    gathered = bounced_light(scenery, light, gather(scenery, origins, normals, indirect, rng), bounces)
    return _smoothed(scenery, light + _smoothed(scenery, gathered, 3), 1).astype(np.float32)


def standpoints(scenery: Scenery) -> tuple[Array, Array]:
    """Return where each point's rays start, just off the surface and off what it touches, and its normal."""
    count = len(scenery.point_corner)
    points = scenery.corners.reshape(-1, 3)[scenery.point_corner]
    normals = scenery.normals.reshape(-1, 3)[scenery.point_corner]
    around = scenery.point.ravel()
    middles = np.repeat(scenery.corners.mean(1), 3, axis=0)
    total = _summed(around, middles, count)
    inwards = total / np.bincount(around, minlength=count)[:, None] - points
    # In the middle of a flat surface this is only rounding, which must not be normalised to a direction.
    inwards /= np.maximum(np.linalg.norm(inwards, axis=1, keepdims=True), 1e-3)
    return (points + 2e-3 * inwards + 2e-3 * normals).astype(np.float32), normals


def direct_light(scenery: Scenery, origins: Array, normals: Array, rays: int, rng: np.random.Generator) -> Array:
    """Return irradiance from materials that emit light, float64 ``[P, 3]``; rays spread evenly over their surfaces."""
    light, count = np.zeros((len(origins), 3)), len(origins)
    for material in np.flatnonzero(scenery.emit > 0):
        triangles = np.flatnonzero(scenery.material == material)
        sums = np.cumsum(scenery.area[triangles])
        for ray in range(rays):
            chosen = np.searchsorted(sums, (ray + rng.random(count)) / rays * sums[-1])
            chosen = triangles[np.minimum(chosen, len(triangles) - 1)]
            u, v = rng.random((2, count), np.float32)
            outside = u + v > 1
            u[outside], v[outside] = 1 - u[outside], 1 - v[outside]
            way = interpolate(scenery.corners[chosen], u, v) - origins
            squared = (way**2).sum(1)
            way /= np.sqrt(squared)[:, None]
            cos_here, cos_there = (way * normals).sum(1), -(way * scenery.facing[chosen]).sum(1)
            sees = np.flatnonzero((cos_here > 0) & (cos_there > 0))
            hit = scenery.trace(origins[sees], way[sees]).triangle
            sees = sees[(hit >= 0) & (scenery.material[hit] == material)]
            # Each ray represents an equal share of the emitting surface. The 0.01 bounds the light right beside a lamp.
            solid_angle = cos_there[sees] * sums[-1] / (squared[sees] + 0.01) / rays
            color = scenery.color(chosen[sees], u[sees], v[sees]) * scenery.emit[material]
            light[sees] += color * (cos_here[sees] * solid_angle)[:, None]
    return light


def gather(scenery: Scenery, origins: Array, normals: Array, rays: int, rng: np.random.Generator) -> Array:
    """Return the points that each point sees, cosine-distributed, int32 ``[rays, P]``; -1 for nothing or a light."""
    side, count = int(np.sqrt(rays)), len(origins)
    across = unit(np.cross(np.where(np.abs(normals[:, 2:]) < 0.9, [[0.0, 0, 1]], [[1.0, 0, 0]]), normals))
    along = np.cross(normals, across)
    seen = np.empty((side * side, count), np.int32)
    for ray in range(side * side):
        radius = np.sqrt((ray % side + rng.random(count)) / side)
        angle = 2 * np.pi * (ray // side + rng.random(count)) / side
        way = across * (radius * np.cos(angle))[:, None] + along * (radius * np.sin(angle))[:, None]
        way += normals * np.sqrt(1 - radius**2)[:, None]
        hits = scenery.trace(origins, way)
        nearest = np.stack([1 - hits.u - hits.v, hits.u, hits.v]).argmax(0)
        dark = (hits.triangle < 0) | (scenery.emit[scenery.material[hits.triangle]] > 0)
        seen[ray] = np.where(dark, -1, scenery.point[hits.triangle, nearest])
    return seen


def bounced_light(scenery: Scenery, light: Array, seen: Array, bounces: int) -> Array:
    """Return irradiance that comes from other surfaces, ``[P, 3]``, given the direct one and what each point sees."""
    albedo = np.zeros((len(light), 3), np.float32)
    albedo[scenery.point.ravel()] = np.repeat(scenery.mean_color[scenery.material], 3, axis=0)
    gathered = np.zeros_like(light)
    for _ in range(bounces):
        sent = np.vstack([(light + gathered) * albedo, np.zeros((1, 3))])  # the last row, -1, sends nothing
        gathered = np.zeros_like(light)
        for points in seen:
            gathered += sent[points]
        gathered /= len(seen)
    return gathered


def _smoothed(scenery: Scenery, light: Array, rounds: int) -> Array:
    """Average each point's light with its neighbours', against the noise of few rays."""
    around, count = scenery.point.ravel(), len(light)
    for _ in range(rounds):
        sums = np.repeat(light[scenery.point].sum(1), 3, axis=0)
        light = _summed(around, sums, count) / (3 * np.bincount(around, minlength=count))[:, None]
    return light


def _summed(group: Array, values: Array, count: int) -> Array:
    """Return the sums of values, ``[n, 3]``, over the members of each group, ``[count, 3]``."""
    return np.stack([np.bincount(group, values[:, k], count) for k in range(3)], 1)
