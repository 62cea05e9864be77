"""Wallpapers: a motif on a ground, repeating seamlessly."""

import numpy as np

from dirl.rooms.textures.noise import Array, coordinates, fractal_noise, mix, rgb

Generator = np.random.Generator


def _ground(rng: Generator, n: int, ground: str) -> Array:
    return mix(rgb(ground), rgb(ground) * 0.93, fractal_noise(rng, n, n, 32, 32, 4))


def damask(
    rng: Generator,
    n: int,
    *,
    ground: str = "#dfe6dc",
    motif: str = "#7f9f86",
    accent: str = "#c58a5b",
    nx: int = 3,
    ny: int = 4,
) -> Array:
    """Rosettes in rings, every second row shifted by half (``ny`` must be even to repeat)."""
    v, u = coordinates(n)
    out = _ground(rng, n, ground)
    row = np.floor(v * ny)
    x, y = (u * nx + 0.5 * (row % 2)) % 1 - 0.5, (v * ny) % 1 - 0.5
    r, angle = np.hypot(x, y * 0.8), np.arctan2(y, x)
    petal = np.abs(np.cos(3 * angle)) * 0.22 + 0.08
    out[(r < petal) & (r > petal * 0.55)] = rgb(motif)
    out[r < 0.06] = rgb(accent)
    out[np.abs(np.hypot(x, y) - 0.40 - 0.03 * np.cos(8 * angle)) < 0.012] = rgb(motif)
    return out


def stripe(
    rng: Generator,
    n: int,
    *,
    ground: str = "#dfe6dc",
    motif: str = "#7f9f86",
    accent: str = "#c58a5b",
    nx: int = 3,
) -> Array:
    """Upright stripes, ``nx`` of them, edged in the accent."""
    _, u = coordinates(n)
    out = _ground(rng, n, ground)
    wave = np.sin(2 * np.pi * nx * u)
    out[wave > 0.35] = rgb(motif)
    out[np.abs(wave - 0.35) < 0.08] = rgb(accent)
    return out


def leaf(
    rng: Generator,
    n: int,
    *,
    ground: str = "#dfe6dc",
    motif: str = "#7f9f86",
    accent: str = "#c58a5b",
    leaves: int = 36,
) -> Array:
    """Scattered leaves with a midrib in the accent."""
    v, u = coordinates(n)
    out = _ground(rng, n, ground)
    for _ in range(leaves):
        cu, cv, angle = rng.random(), rng.random(), rng.random() * np.pi
        du, dv = (u - cu + 0.5) % 1 - 0.5, (v - cv + 0.5) % 1 - 0.5
        p, q = du * np.cos(angle) + dv * np.sin(angle), dv * np.cos(angle) - du * np.sin(angle)
        blade = (p / 0.10) ** 2 + (q / np.maximum(0.032 * (1 - 4 * np.abs(p)), 1e-6)) ** 2 < 1
        out[blade] = rgb(motif) * (0.7 + 0.5 * rng.random())
        out[blade & (np.abs(q) < 0.0025)] = rgb(accent)
    return np.clip(out, 0, 1)


def dots(
    rng: Generator,
    n: int,
    *,
    ground: str = "#dfe6dc",
    motif: str = "#7f9f86",
    accent: str = "#c58a5b",
    nx: int = 5,
) -> Array:
    """Dots in staggered rows, a few of them in the accent."""
    nx += nx % 2
    v, u = coordinates(n)
    out = _ground(rng, n, ground)
    row = np.floor(v * nx).astype(int)
    shifted = u * nx + 0.5 * (row % 2)
    column = np.floor(shifted).astype(int) % nx
    dot = np.hypot(shifted % 1 - 0.5, (v * nx) % 1 - 0.5) < 0.24
    special = rng.random((nx, nx))[row, column] < 0.25
    out[dot] = rgb(motif)
    out[dot & special] = rgb(accent)
    return out


def trellis(
    rng: Generator,
    n: int,
    *,
    ground: str = "#dfe6dc",
    motif: str = "#7f9f86",
    accent: str = "#c58a5b",
    nx: int = 4,
) -> Array:
    """A lattice of diamonds with a small flower in each second one."""
    v, u = coordinates(n)
    out = _ground(rng, n, ground)
    p, q = nx * (u + v), nx * (u - v)
    out[np.minimum(np.abs(p - np.round(p)), np.abs(q - np.round(q))) < 0.06] = rgb(motif)
    x, y = p % 1 - 0.5, q % 1 - 0.5
    flowering = (np.floor(p) + np.floor(q)) % 2 == 0
    out[flowering & (np.hypot(x, y) < 0.13 + 0.06 * np.cos(5 * np.arctan2(y, x)))] = rgb(accent)
    return out


def chevron(
    rng: Generator,
    n: int,
    *,
    ground: str = "#dfe6dc",
    motif: str = "#7f9f86",
    accent: str = "#c58a5b",
    nx: int = 4,
) -> Array:
    """Zigzag bands, lined in the accent."""
    v, u = coordinates(n)
    out = _ground(rng, n, ground)
    band = (v * nx + 0.7 * np.abs((u * nx) % 1 - 0.5)) % 1
    out[band < 0.45] = rgb(motif)
    out[np.abs(band - 0.45) < 0.035] = rgb(accent)
    return out
