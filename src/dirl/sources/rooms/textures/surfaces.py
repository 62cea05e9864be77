"""Textures of floors, walls and furniture, and wallpapers, a motif on a ground; all repeat seamlessly."""

import numpy as np

from dirl.sources.rooms.textures.noise import Array, coordinates, fractal_noise, mix, palette, rgb

Generator = np.random.Generator

GROUND, MOTIF, ACCENT = "#dfe6dc", "#7f9f86", "#c58a5b"
"""Of wallpapers."""


def plain(rng: Generator, n: int, *, color: str = "#dddddd", var: float = 0.04) -> Array:
    """Paint, a little uneven: ``var`` is the fraction of the brightness that varies."""
    uneven = fractal_noise(rng, n, n, 6, 6, 6) - 0.5
    return np.clip(rgb(color) * (1 + 2 * var * uneven[..., None]), 0, 1)


def wood(rng: Generator, n: int, *, a: str = "#8a5a33", b: str = "#c99a66", rings: float = 7.0) -> Array:
    """Grain along the columns, from the dark colour ``a`` to the light ``b``."""
    v, _ = coordinates(n)
    warp = fractal_noise(rng, n, n, 4, 2, 4)
    fine = fractal_noise(rng, n, n, min(96, n), 4, 3)
    ring = np.sin(2 * np.pi * (round(rings) * v + 2.2 * warp)) * 0.5 + 0.5
    share = np.clip(0.55 * ring + 0.45 * fine + 0.25 * (fractal_noise(rng, n, n, 2, 2, 3) - 0.5), 0, 1)
    return np.clip(mix(rgb(a), rgb(b), share) * (0.92 + 0.16 * fine[..., None]), 0, 1)


def planks(rng: Generator, n: int, *, a: str = "#7c5230", b: str = "#bf8f5c", rows: int = 6) -> Array:
    """Floor boards in rows, two boards long, each of its own tone, with dark seams."""
    grain = wood(rng, n, a=a, b=b, rings=rows * 1.6)
    v, u = coordinates(n)
    row = (v * rows).astype(int)
    along = u * 2 + rng.random(rows)[row]
    tone = rng.random((rows, 2))[row, np.floor(along).astype(int) % 2]
    seam = np.minimum(np.abs(v * rows - np.round(v * rows)) / rows, np.abs(along - np.round(along)) / 2)
    dark = np.clip(seam / 0.0035, 0.25, 1)
    return np.clip(grain * (0.72 + 0.5 * tone[..., None]) * dark[..., None], 0, 1)


def herringbone(rng: Generator, n: int, *, a: str = "#7c5230", b: str = "#bf8f5c", rows: int = 8) -> Array:
    """Parquet laid in zigzags, ``rows`` boards across (made even, so that it repeats)."""
    rows += rows % 2
    v, u = coordinates(n)
    column = np.floor(u * rows).astype(int)
    inside = u * rows - column
    slanted = v * rows + np.where(column % 2 == 0, inside, 1 - inside)
    board = np.floor(slanted).astype(int) % rows
    tone = rng.random((rows, rows))[board, column]
    grain = wood(rng, n, a=a, b=b, rings=rows * 2)
    seam = np.minimum(np.abs(slanted - np.round(slanted)), np.minimum(inside, 1 - inside)) / rows
    dark = np.clip(seam / 0.003, 0.3, 1)
    return np.clip(grain * (0.7 + 0.55 * tone[..., None]) * dark[..., None], 0, 1)


def tile(
    rng: Generator,
    n: int,
    *,
    colors: tuple[str, ...] = ("#f2f2ee",),
    grout: str = "#b9b6ae",
    nx: int = 4,
    ny: int = 4,
    brick: bool = False,
    checker: bool = False,
    var: float = 0.10,
    gap: float = 0.02,
) -> Array:
    """Tiles or bricks, ``ny`` rows of ``nx``, each of a random colour (in turn with ``checker``).

    ``brick`` shifts every second row by half a tile, ``var`` is how much tiles differ in tone, ``gap`` the grout's
    width in tiles.
    """
    v, u = coordinates(n)
    y = v * ny
    row = np.floor(y).astype(int)
    x = u * nx + (0.5 * (row % 2) if brick else 0.0)
    column = np.floor(x).astype(int) % nx
    choices = palette(colors)
    choice = (column + row) % len(choices) if checker else rng.integers(len(choices), size=(ny, nx))[row, column]
    tone = 1 + var * (rng.random((ny, nx))[row, column] - 0.5)
    glaze = 0.94 + 0.12 * fractal_noise(rng, n, n, 8, 8, 5)
    body = choices[choice] * (tone * glaze)[..., None]
    edge = np.minimum(np.abs(x - np.round(x)), np.abs(y - np.round(y)))
    share = np.clip((edge - gap * 0.6) / (gap * 0.6), 0, 1)
    return np.clip(mix(rgb(grout), body, share), 0, 1)


def terrazzo(
    rng: Generator,
    n: int,
    *,
    ground: str = "#e8e4da",
    colors: tuple[str, ...] = ("#b5523b", "#3f5e5a", "#d9a441"),
    chips: int = 220,
) -> Array:
    """Chips of stone in cement."""
    out = rgb(ground) * (0.94 + 0.12 * fractal_noise(rng, n, n, 16, 16, 4))[..., None]
    choices = palette(colors)
    for _ in range(chips):
        p, q = _somewhere(rng, n)
        long, short = rng.uniform(0.012, 0.035), rng.uniform(0.008, 0.018)
        out[np.abs(p / long) ** 1.3 + np.abs(q / short) ** 1.3 < 1] = choices[rng.integers(len(choices))]
    return np.clip(out, 0, 1)


def marble(rng: Generator, n: int, *, a: str = "#f4f1ec", b: str = "#8c8680", scale: int = 3) -> Array:
    """Stone of colour ``a`` with veins of colour ``b``."""
    v, u = coordinates(n)
    warp = fractal_noise(rng, n, n, scale, scale, 6)
    vein = np.clip(1 - np.abs(np.sin(2 * np.pi * (u + v + 2 * warp))) * 3.2, 0, 1) ** 1.5
    cloud = 0.35 * fractal_noise(rng, n, n, 4, 4, 5)
    return mix(rgb(a), rgb(b), np.clip(0.8 * vein + 0.5 * (cloud - 0.15), 0, 1))


def fabric(
    rng: Generator,
    n: int,
    *,
    color: str = "#31618c",
    color2: str = "#31618c",
    threads: int = 96,
    stripes: int = 0,
) -> Array:
    """Woven cloth or wicker; with ``stripes`` of the second colour across the columns."""
    v, u = coordinates(n)
    across, along = np.sin(2 * np.pi * threads * u), np.sin(2 * np.pi * threads * v)
    weave = 0.5 + 0.25 * across * np.sign(np.sin(np.pi * threads * v)) + 0.25 * along
    striped = (np.sin(2 * np.pi * stripes * v) > 0.2)[..., None]
    base = np.where(striped, rgb(color2), rgb(color))
    shade = 0.75 + 0.3 * weave + 0.25 * (fractal_noise(rng, n, n, 8, 8, 5) - 0.5)
    return np.clip(base * shade[..., None], 0, 1)


def gingham(rng: Generator, n: int, *, color: str = "#b8433a", ground: str = "#f4efe4", checks: int = 6) -> Array:
    """Chequered cloth: bands of colour along both axes over a light ground."""
    v, u = coordinates(n)
    bands = (np.floor(2 * checks * u) % 2 + np.floor(2 * checks * v) % 2) / 2
    shade = 0.9 + 0.2 * fractal_noise(rng, n, n, 32, 32, 3)
    return np.clip(mix(rgb(ground), rgb(color), bands) * shade[..., None], 0, 1)


def leafy(rng: Generator, n: int, *, a: str = "#2f5d2a", b: str = "#7fb069") -> Array:
    """The blade of a leaf."""
    return mix(rgb(a), rgb(b), fractal_noise(rng, n, n, 8, 24, 4))


def _somewhere(rng: Generator, n: int) -> tuple[Array, Array]:
    """Coordinates of the pixels from a random point, turned by a random angle, ``[n, n]`` each."""
    v, u = coordinates(n)
    cu, cv, angle = rng.random(), rng.random(), rng.random() * np.pi
    du, dv = (u - cu + 0.5) % 1 - 0.5, (v - cv + 0.5) % 1 - 0.5
    return du * np.cos(angle) + dv * np.sin(angle), dv * np.cos(angle) - du * np.sin(angle)


def _ground(rng: Generator, n: int, ground: str) -> Array:
    return mix(rgb(ground), rgb(ground) * 0.93, fractal_noise(rng, n, n, 32, 32, 4))


def damask(
    rng: Generator, n: int, *, ground: str = GROUND, motif: str = MOTIF, accent: str = ACCENT, nx: int = 3, ny: int = 4
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
    rng: Generator, n: int, *, ground: str = GROUND, motif: str = MOTIF, accent: str = ACCENT, nx: int = 3
) -> Array:
    """Upright stripes, ``nx`` of them, edged in the accent."""
    _, u = coordinates(n)
    out = _ground(rng, n, ground)
    wave = np.sin(2 * np.pi * nx * u)
    out[wave > 0.35] = rgb(motif)
    out[np.abs(wave - 0.35) < 0.08] = rgb(accent)
    return out


def leaf(
    rng: Generator, n: int, *, ground: str = GROUND, motif: str = MOTIF, accent: str = ACCENT, leaves: int = 36
) -> Array:
    """Scattered leaves with a midrib in the accent."""
    out = _ground(rng, n, ground)
    for _ in range(leaves):
        p, q = _somewhere(rng, n)
        blade = (p / 0.10) ** 2 + (q / np.maximum(0.032 * (1 - 4 * np.abs(p)), 1e-6)) ** 2 < 1
        out[blade] = rgb(motif) * (0.7 + 0.5 * rng.random())
        out[blade & (np.abs(q) < 0.0025)] = rgb(accent)
    return np.clip(out, 0, 1)


def dots(
    rng: Generator, n: int, *, ground: str = GROUND, motif: str = MOTIF, accent: str = ACCENT, nx: int = 5
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
    rng: Generator, n: int, *, ground: str = GROUND, motif: str = MOTIF, accent: str = ACCENT, nx: int = 4
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
    rng: Generator, n: int, *, ground: str = GROUND, motif: str = MOTIF, accent: str = ACCENT, nx: int = 4
) -> Array:
    """Zigzag bands, lined in the accent."""
    v, u = coordinates(n)
    out = _ground(rng, n, ground)
    band = (v * nx + 0.7 * np.abs((u * nx) % 1 - 0.5)) % 1
    out[band < 0.45] = rgb(motif)
    out[np.abs(band - 0.45) < 0.035] = rgb(accent)
    return out
