"""What the textures are made of: noise that repeats seamlessly, colours, coordinates."""

import re

import numpy as np
from PIL import ImageColor

Array = np.ndarray


def rgb(color: str) -> Array:
    """Return a colour such as ``#d94f30`` as sRGB in [0, 1], float64 ``[3]``; ValueError if the text is none."""
    if not re.fullmatch("#[0-9a-fA-F]{6}", color):
        raise ValueError(f"'{color}' is no colour; write e.g. '#d94f30'")
    return np.array(ImageColor.getrgb(color)) / 255.0


def palette(colors: tuple[str, ...]) -> Array:
    """Return several colours, float64 ``[k, 3]``."""
    if not colors:
        raise ValueError("colors: name at least one")
    return np.stack([rgb(color) for color in colors])


def mix(a: Array, b: Array, share: Array) -> Array:
    """Mix colours ``a`` and ``b``; ``share`` is ``b``'s, ``[h, w]``."""
    return a * (1 - share[..., None]) + b * share[..., None]


def fractal_noise(rng: np.random.Generator, height: int, width: int, fy: int, fx: int, octaves: int) -> Array:
    """Return value noise in [0, 1] that repeats seamlessly, float64 ``[height, width]``.

    Of the coarsest octave there are ``fy`` cells along the rows and ``fx`` along the columns; every further octave
    doubles them and weighs half. Those finer than a pixel are left out, but for the first.
    """
    total, weight, weights = np.zeros((height, width)), 1.0, 0.0
    for octave in range(octaves):
        ny, nx = fy * 2**octave, fx * 2**octave
        if octave and (ny > height or nx > width):
            break
        ny, nx = min(ny, height), min(nx, width)
        lattice = rng.random((ny, nx))
        y, x = np.arange(height) * ny / height, np.arange(width) * nx / width
        iy, ix = y.astype(int), x.astype(int)
        ty, tx = ((t * t * (3 - 2 * t)) for t in (y - iy, x - ix))
        below, beside = (iy + 1) % ny, (ix + 1) % nx
        top = lattice[iy][:, ix] * (1 - tx) + lattice[iy][:, beside] * tx
        bottom = lattice[below][:, ix] * (1 - tx) + lattice[below][:, beside] * tx
        total += weight * (top * (1 - ty[:, None]) + bottom * ty[:, None])
        weights += weight
        weight /= 2
    return total / weights


class Canvas:
    """A square of ``n`` pixels a side to be painted at random; ``v`` and ``u`` are its pixels' rows and columns.

    Those of their centres, in [0, 1], v downwards, ``[n, n]`` each.
    """

    def __init__(self, rng: np.random.Generator, n: int) -> None:
        self.rng, self.n = rng, n
        centres = (np.arange(n) + 0.5) / n
        self.v, self.u = np.meshgrid(centres, centres, indexing="ij")

    def noise(self, fy: int, fx: int, octaves: int = 5) -> Array:
        """See `fractal_noise`."""
        return fractal_noise(self.rng, self.n, self.n, fy, fx, octaves)
