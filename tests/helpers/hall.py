"""A hall with painted walls, and what a camera sees in it: recordings for tests."""

from functools import cache

import numpy as np
import torch
import torch.nn.functional as F

LENGTH, WIDTH, TALL = 24.0, 5.0, 2.6
"""Metres."""

PER_METRE = 40


@cache
def walls(seed):
    """Six textures, uint8 [6, 1040, 1040, 3], of blots of all sizes; a seed is a hall."""
    generator = torch.Generator().manual_seed(seed)
    total = 0
    for cells in (8, 33, 130, 520):
        noise = torch.rand(6, 3, cells, cells, generator=generator)
        total = total + F.interpolate(noise, (1040, 1040), mode="nearest")
    return (255 * (total / 4)).permute(0, 2, 3, 1).byte().numpy()


@cache
def look(x, z, heading, seed=0, size=(144, 256), fov=65.0):
    """What is seen at x along the hall and z across it, uint8 [*size, 3]; headings to the left, degrees, 0 along x."""
    height, width = size
    half = np.tan(np.radians(fov / 2))
    across = ((np.arange(width) + 0.5) / width * 2 - 1) * half
    down = ((np.arange(height) + 0.5) / height * 2 - 1) * half * height / width
    right, below = np.meshgrid(across, down)
    cos, sin = np.cos(np.radians(heading)), np.sin(np.radians(heading))
    rays = np.stack([cos + right * sin, sin - right * cos, -below])
    start, high = (np.array(point)[:, None, None] for point in ([x, z, 1.4], [LENGTH, WIDTH, TALL]))
    with np.errstate(divide="ignore"):
        far = np.abs(((rays > 0) * high - start) / rays)  # from within a hall a ray meets one of two opposite walls
    axis = far.argmin(0)
    x, z, y = np.clip((start + far.min(0) * rays) * PER_METRE, 0, 1039).astype(int)
    side = np.take_along_axis(rays > 0, axis[None], 0)[0]
    return walls(seed)[2 * axis + side, np.where(axis == 0, z, x), np.where(axis == 2, z, y)]


def walk(steps, seed=0, **options):
    """A recording, of places and headings (x, z, heading), one a second: image, time, no odometry."""
    return [(look(*step, seed=seed, **options), float(second), None) for second, step in enumerate(steps)]
