"""Textures of floors, walls and furniture, and wallpapers, a motif on a ground; all repeat seamlessly."""

import numpy as np

from dirl.sources.rooms.textures.noise import Array, Canvas, mix, palette, rgb

GROUND, MOTIF, ACCENT = "#dfe6dc", "#7f9f86", "#c58a5b"
"""Colours of wallpapers."""


def plain(c: Canvas, *, color: str = "#dddddd", var: float = 0.04) -> Array:
    """Paint, a little uneven: ``var`` is the fraction of the brightness that varies."""
    uneven = c.noise(6, 6, 6) - 0.5
    return np.clip(rgb(color) * (1 + 2 * var * uneven[..., None]), 0, 1)


def wood(c: Canvas, *, a: str = "#8a5a33", b: str = "#c99a66", rings: float = 7.0) -> Array:
    """Draw grain along the columns, from the dark colour ``a`` to the light ``b``."""
    warp = c.noise(4, 2, 4)
    fine = c.noise(min(96, c.n), 4, 3)
    ring = np.sin(2 * np.pi * (round(rings) * c.v + 2.2 * warp)) * 0.5 + 0.5
    share = np.clip(0.55 * ring + 0.45 * fine + 0.25 * (c.noise(2, 2, 3) - 0.5), 0, 1)
    return np.clip(mix(rgb(a), rgb(b), share) * (0.92 + 0.16 * fine[..., None]), 0, 1)


def planks(c: Canvas, *, a: str = "#7c5230", b: str = "#bf8f5c", rows: int = 6) -> Array:
    """Draw floor boards in rows, two boards long, each of its own tone, with dark seams."""
    grain = wood(c, a=a, b=b, rings=rows * 1.6)
    row = (c.v * rows).astype(int)
    along = c.u * 2 + c.rng.random(rows)[row]
    tone = c.rng.random((rows, 2))[row, np.floor(along).astype(int) % 2]
    seam = np.minimum(np.abs(c.v * rows - np.round(c.v * rows)) / rows, np.abs(along - np.round(along)) / 2)
    dark = np.clip(seam / 0.0035, 0.25, 1)
    return np.clip(grain * (0.72 + 0.5 * tone[..., None]) * dark[..., None], 0, 1)


def herringbone(c: Canvas, *, a: str = "#7c5230", b: str = "#bf8f5c", rows: int = 8) -> Array:
    """Draw parquet laid in zigzags, ``rows`` boards across (made even, so that it repeats)."""
    rows += rows % 2
    column = np.floor(c.u * rows).astype(int)
    inside = c.u * rows - column
    slanted = c.v * rows + np.where(column % 2 == 0, inside, 1 - inside)
    board = np.floor(slanted).astype(int) % rows
    tone = c.rng.random((rows, rows))[board, column]
    grain = wood(c, a=a, b=b, rings=rows * 2)
    seam = np.minimum(np.abs(slanted - np.round(slanted)), np.minimum(inside, 1 - inside)) / rows
    dark = np.clip(seam / 0.003, 0.3, 1)
    return np.clip(grain * (0.7 + 0.55 * tone[..., None]) * dark[..., None], 0, 1)


def tile(
    c: Canvas,
    *,
    colors: tuple[str, ...] = ("#f2f2ee",),
    grout: str = "#b9b6ae",
    nx: int = 4,
    ny: int = 4,
    brick: bool = False,
    checker: bool = False,
    var: float = 0.10,
) -> Array:
    """Draw tiles or bricks, ``ny`` rows of ``nx``, each of a random colour (in turn with ``checker``).

    ``brick`` shifts every second row by half a tile, ``var`` is how much tiles differ in tone.
    """
    y = c.v * ny
    row = np.floor(y).astype(int)
    x = c.u * nx + (0.5 * (row % 2) if brick else 0.0)
    column = np.floor(x).astype(int) % nx
    choices = palette(colors)
    choice = (column + row) % len(choices) if checker else c.rng.integers(len(choices), size=(ny, nx))[row, column]
    tone = 1 + var * (c.rng.random((ny, nx))[row, column] - 0.5)
    glaze = 0.94 + 0.12 * c.noise(8, 8, 5)
    body = choices[choice] * (tone * glaze)[..., None]
    edge = np.minimum(np.abs(x - np.round(x)), np.abs(y - np.round(y)))
    gap = 0.02 * 0.6
    share = np.clip((edge - gap) / gap, 0, 1)
    return np.clip(mix(rgb(grout), body, share), 0, 1)


def terrazzo(
    c: Canvas, *, ground: str = "#e8e4da", colors: tuple[str, ...] = ("#b5523b", "#3f5e5a", "#d9a441")
) -> Array:
    """Draw chips of stone in cement."""
    out = rgb(ground) * (0.94 + 0.12 * c.noise(16, 16, 4))[..., None]
    choices = palette(colors)
    for _ in range(220):
        p, q = _somewhere(c)
        long, short = c.rng.uniform(0.012, 0.035), c.rng.uniform(0.008, 0.018)
        out[np.abs(p / long) ** 1.3 + np.abs(q / short) ** 1.3 < 1] = choices[c.rng.integers(len(choices))]
    return np.clip(out, 0, 1)


def marble(c: Canvas, *, a: str = "#f4f1ec", b: str = "#8c8680", scale: int = 3) -> Array:
    """Draw stone of colour ``a`` with veins of colour ``b``."""
    warp = c.noise(scale, scale, 6)
    vein = np.clip(1 - np.abs(np.sin(2 * np.pi * (c.u + c.v + 2 * warp))) * 3.2, 0, 1) ** 1.5
    cloud = 0.35 * c.noise(4, 4, 5)
    return mix(rgb(a), rgb(b), np.clip(0.8 * vein + 0.5 * (cloud - 0.15), 0, 1))


def fabric(c: Canvas, *, color: str = "#31618c", color2: str = "#31618c", threads: int = 96, stripes: int = 0) -> Array:
    """Draw woven cloth or wicker; with ``stripes`` of the second colour across the columns."""
    across, along = np.sin(2 * np.pi * threads * c.u), np.sin(2 * np.pi * threads * c.v)
    weave = 0.5 + 0.25 * across * np.sign(np.sin(np.pi * threads * c.v)) + 0.25 * along
    striped = (np.sin(2 * np.pi * stripes * c.v) > 0.2)[..., None]
    base = np.where(striped, rgb(color2), rgb(color))
    shade = 0.75 + 0.3 * weave + 0.25 * (c.noise(8, 8, 5) - 0.5)
    return np.clip(base * shade[..., None], 0, 1)


def gingham(c: Canvas, *, color: str = "#b8433a", ground: str = "#f4efe4", checks: int = 6) -> Array:
    """Draw chequered cloth: bands of colour along both axes over a light ground."""
    bands = (np.floor(2 * checks * c.u) % 2 + np.floor(2 * checks * c.v) % 2) / 2
    shade = 0.9 + 0.2 * c.noise(32, 32, 3)
    return np.clip(mix(rgb(ground), rgb(color), bands) * shade[..., None], 0, 1)


def leafy(c: Canvas, *, a: str = "#2f5d2a", b: str = "#7fb069") -> Array:
    """Draw the blade of a leaf."""
    return mix(rgb(a), rgb(b), c.noise(8, 24, 4))


def _somewhere(c: Canvas) -> tuple[Array, Array]:
    """Return pixel coordinates from a random point, turned by a random angle, ``[n, n]`` each."""
    cu, cv, angle = c.rng.random(), c.rng.random(), c.rng.random() * np.pi
    du, dv = (c.u - cu + 0.5) % 1 - 0.5, (c.v - cv + 0.5) % 1 - 0.5
    return du * np.cos(angle) + dv * np.sin(angle), dv * np.cos(angle) - du * np.sin(angle)


def _ground(c: Canvas, ground: str) -> Array:
    return mix(rgb(ground), rgb(ground) * 0.93, c.noise(32, 32, 4))


def damask(
    c: Canvas, *, ground: str = GROUND, motif: str = MOTIF, accent: str = ACCENT, nx: int = 3, ny: int = 4
) -> Array:
    """Draw rosettes in rings, every second row shifted by half (``ny`` must be even to repeat)."""
    out = _ground(c, ground)
    row = np.floor(c.v * ny)
    x, y = (c.u * nx + 0.5 * (row % 2)) % 1 - 0.5, (c.v * ny) % 1 - 0.5
    r, angle = np.hypot(x, y * 0.8), np.arctan2(y, x)
    petal = np.abs(np.cos(3 * angle)) * 0.22 + 0.08
    out[(r < petal) & (r > petal * 0.55)] = rgb(motif)
    out[r < 0.06] = rgb(accent)
    out[np.abs(np.hypot(x, y) - 0.40 - 0.03 * np.cos(8 * angle)) < 0.012] = rgb(motif)
    return out


def stripe(c: Canvas, *, ground: str = GROUND, motif: str = MOTIF, accent: str = ACCENT, nx: int = 3) -> Array:
    """Draw upright stripes, ``nx`` of them, edged in the accent."""
    out = _ground(c, ground)
    wave = np.sin(2 * np.pi * nx * c.u)
    out[wave > 0.35] = rgb(motif)
    out[np.abs(wave - 0.35) < 0.08] = rgb(accent)
    return out


def leaf(c: Canvas, *, ground: str = GROUND, motif: str = MOTIF, accent: str = ACCENT, leaves: int = 36) -> Array:
    """Draw scattered leaves with a midrib in the accent."""
    out = _ground(c, ground)
    for _ in range(leaves):
        p, q = _somewhere(c)
        blade = (p / 0.10) ** 2 + (q / np.maximum(0.032 * (1 - 4 * np.abs(p)), 1e-6)) ** 2 < 1
        out[blade] = rgb(motif) * (0.7 + 0.5 * c.rng.random())
        out[blade & (np.abs(q) < 0.0025)] = rgb(accent)
    return np.clip(out, 0, 1)


def dots(c: Canvas, *, ground: str = GROUND, motif: str = MOTIF, accent: str = ACCENT, nx: int = 5) -> Array:
    """Draw dots in staggered rows, a few of them in the accent."""
    nx += nx % 2
    out = _ground(c, ground)
    row = np.floor(c.v * nx).astype(int)
    shifted = c.u * nx + 0.5 * (row % 2)
    column = np.floor(shifted).astype(int) % nx
    dot = np.hypot(shifted % 1 - 0.5, (c.v * nx) % 1 - 0.5) < 0.24
    special = c.rng.random((nx, nx))[row, column] < 0.25
    out[dot] = rgb(motif)
    out[dot & special] = rgb(accent)
    return out


def trellis(c: Canvas, *, ground: str = GROUND, motif: str = MOTIF, accent: str = ACCENT, nx: int = 4) -> Array:
    """Draw a lattice of diamonds with a small flower in each second one."""
    out = _ground(c, ground)
    p, q = nx * (c.u + c.v), nx * (c.u - c.v)
    out[np.minimum(np.abs(p - np.round(p)), np.abs(q - np.round(q))) < 0.06] = rgb(motif)
    x, y = p % 1 - 0.5, q % 1 - 0.5
    flowering = (np.floor(p) + np.floor(q)) % 2 == 0
    out[flowering & (np.hypot(x, y) < 0.13 + 0.06 * np.cos(5 * np.arctan2(y, x)))] = rgb(accent)
    return out


def chevron(c: Canvas, *, ground: str = GROUND, motif: str = MOTIF, accent: str = ACCENT, nx: int = 4) -> Array:
    """Draw zigzag bands, lined in the accent."""
    out = _ground(c, ground)
    band = (c.v * nx + 0.7 * np.abs((c.u * nx) % 1 - 0.5)) % 1
    out[band < 0.45] = rgb(motif)
    out[np.abs(band - 0.45) < 0.035] = rgb(accent)
    return out
