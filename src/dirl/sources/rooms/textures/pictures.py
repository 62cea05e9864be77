"""Textures with one image each: paintings, rugs, book spines, a fire, and what a window or a screen shows."""

from itertools import pairwise

import numpy as np

from dirl.sources.rooms.textures.noise import Array, coordinates, fractal_noise, mix, palette, rgb

Generator = np.random.Generator


def abstract(
    rng: Generator,
    n: int,
    *,
    colors: tuple[str, ...] = ("#d94f30", "#f2c14e", "#2a6f97", "#f4f1de", "#22223b"),
    cells: int = 14,
) -> Array:
    """Fields of colour around random points, leaded like a church window."""
    v, u = coordinates(n)
    points = rng.random((max(2, cells), 2))
    distance = np.hypot(u[..., None] - points[:, 0], v[..., None] - points[:, 1])
    nearest = np.partition(distance, 1, -1)
    fields = palette(colors)[rng.integers(len(colors), size=len(points))]
    out = fields[distance.argmin(-1)] * (0.85 + 0.3 * fractal_noise(rng, n, n, 24, 24, 3)[..., None])
    out[(nearest[..., 1] - nearest[..., 0]) < 0.012] = 0.06
    return np.clip(out, 0, 1)


def blocks(
    rng: Generator, n: int, *, colors: tuple[str, ...] = ("#c8102e", "#f6d000", "#0b4ea2", "#f5f3ea"), lines: int = 4
) -> Array:
    """Rectangles between black lines; the last colour is the ground."""
    choices = palette(colors)
    v, u = coordinates(n)
    xs, ys = (np.r_[0, np.sort(rng.uniform(0.1, 0.9, lines)), 1] for _ in range(2))
    out = np.full((n, n, 3), choices[-1])
    for x0, x1 in pairwise(xs):
        for y0, y1 in pairwise(ys):
            if rng.random() < 0.45:
                inside = (u > x0) & (u < x1) & (v > y0) & (v < y1)
                out[inside] = choices[rng.integers(max(1, len(choices) - 1))]
    for x, y in zip(xs, ys, strict=True):
        out[(np.abs(u - x) < 0.012) | (np.abs(v - y) < 0.012)] = 0.05
    return out


def circles(
    rng: Generator,
    n: int,
    *,
    colors: tuple[str, ...] = ("#e4572e", "#17bebb", "#ffc914", "#2e282a", "#76b041"),
    cells: int = 3,
) -> Array:
    """Concentric rings of colour in a grid of squares."""
    v, u = coordinates(n)
    row, column = np.floor(v * cells).astype(int), np.floor(u * cells).astype(int)
    radius = np.hypot((u * cells) % 1 - 0.5, (v * cells) % 1 - 0.5)
    ring = np.minimum((radius * 8.5).astype(int), 4)
    choice = rng.integers(len(colors), size=(cells, cells, 5))[row, column, ring]
    return np.clip(palette(colors)[choice] * (0.85 + 0.3 * fractal_noise(rng, n, n, 16, 16, 4)[..., None]), 0, 1)


def bouquet(
    rng: Generator,
    n: int,
    *,
    ground: str = "#2f3e46",
    colors: tuple[str, ...] = ("#e76f51", "#f4a261", "#e9c46a", "#fefae0"),
    flowers: int = 16,
) -> Array:
    """Flowers in a vase, loosely painted."""
    v, u = coordinates(n)
    out = rgb(ground) * (0.7 + 0.6 * fractal_noise(rng, n, n, 4, 4, 5))[..., None]
    out[v > 0.82] *= 0.6
    choices = palette(colors)
    for _ in range(2 * flowers):  # foliage behind the flowers
        cu, cv, angle = rng.normal(0.5, 0.2), rng.normal(0.42, 0.16), rng.random() * np.pi
        p, q = (
            (u - cu) * np.cos(angle) + (v - cv) * np.sin(angle),
            (v - cv) * np.cos(angle) - (u - cu) * np.sin(angle),
        )
        out[(p / 0.11) ** 2 + (q / 0.03) ** 2 < 1] = rgb("#4f772d") * rng.uniform(0.5, 1.1)
    out[(v > 0.62) & (v < 0.9) & (np.abs(u - 0.5) < 0.12 + 0.06 * np.sin((v - 0.62) * 9))] = choices[-1] * 0.85
    for _ in range(flowers):
        cu, cv, size = rng.normal(0.5, 0.17), rng.normal(0.38, 0.13), rng.uniform(0.05, 0.1)
        r, around = np.hypot(u - cu, v - cv), np.arctan2(v - cv, u - cu)
        petals = r < size * (0.75 + 0.25 * np.cos(rng.integers(5, 9) * around))
        color = choices[rng.integers(len(choices))]
        out[petals] = color * (0.6 + 0.4 * np.minimum(r[petals] / size, 1))[:, None]
        out[r < 0.25 * size] = rgb("#5c3d1e")
    return np.clip(out, 0, 1)


def rug(rng: Generator, n: int, *, colors: tuple[str, ...] = ("#7a1f1f", "#d8b26e", "#1f3a5f", "#efe3c8")) -> Array:
    """A carpet with a star in a border; the colours are field, ornament, border and lines."""
    field, ornament, border, line = _four(colors)
    v, u = coordinates(n)
    x, y = np.abs(u - 0.5) * 2, np.abs(v - 0.5) * 2
    edge = np.maximum(x, y)
    out = np.full((n, n, 3), field)
    out[edge > 0.72] = border
    zigzag = np.abs((np.where(x > y, y, x) * 9) % 1 - 0.5)
    out[(edge > 0.76) & (edge < 0.92) & (np.abs(edge - 0.84) < 0.07 * (1 - 2 * zigzag) + 0.01)] = ornament
    out[(np.abs(edge - 0.72) < 0.015) | (np.abs(edge - 0.95) < 0.012)] = line
    r, angle = np.hypot(x, y), np.arctan2(y, x)
    star = 0.38 + 0.12 * np.cos(8 * angle)
    out[(r < star) & (edge < 0.7)] = ornament
    out[(r < star * 0.75) & (edge < 0.7)] = border
    out[r < 0.14 + 0.05 * np.cos(6 * angle)] = line
    return np.clip(out * (0.8 + 0.4 * fractal_noise(rng, n, n, 64, 64, 3))[..., None], 0, 1)


def kilim(
    rng: Generator,
    n: int,
    *,
    colors: tuple[str, ...] = ("#a23e2a", "#e5c687", "#2d4a58", "#f0e6d2"),
    rows: int = 5,
) -> Array:
    """A flat-woven rug: bands of stepped diamonds, each band in its own colours."""
    choices = _four(colors)
    v, u = coordinates(n)
    out = np.empty((n, n, 3))
    band = np.minimum((v * rows).astype(int), rows - 1)
    for k in range(rows):
        ground, shape = rng.permutation(4)[:2]
        count = int(rng.integers(3, 8))
        x, y = np.abs((u * count) % 1 - 0.5) * 2, np.abs((v * rows) % 1 - 0.5) * 2
        stepped = np.floor((x + y) * 5) / 5
        part = np.where((stepped < 0.8)[..., None], choices[shape], choices[ground])
        part = np.where((stepped < 0.35)[..., None], choices[ground], part)
        out[band == k] = part[band == k]
    out[np.abs(v * rows - np.round(v * rows)) < 0.05] = choices[3]
    return np.clip(out * (0.8 + 0.4 * fractal_noise(rng, n, n, 64, 64, 3))[..., None], 0, 1)


def _four(colors: tuple[str, ...]) -> Array:
    if len(colors) != 4:
        raise ValueError(f"colors: expected four of them, found {len(colors)}")
    return palette(colors)


def books(rng: Generator, n: int) -> Array:
    """A row of book spines."""
    out = np.full((n, n, 3), 0.08)
    x = 0
    while x < n:
        width, top = int(rng.integers(max(2, n // 36), max(4, n // 14))), int(n * rng.uniform(0.02, 0.25))
        color = rng.random(3) * 0.6 + 0.12
        spine = out[top:, x : x + width - 1]
        spine[:] = color
        band = int(len(spine) * rng.uniform(0.12, 0.3))
        spine[band : band + max(2, n // 24)] = 0.85 * np.clip(color[::-1] + 0.3, 0, 1)
        spine[:, : max(1, width // 10)] *= 0.7
        x += width
    return out


def fire(rng: Generator, n: int) -> Array:
    """Flames, brightest at the bottom."""
    v, u = coordinates(n)
    heat = fractal_noise(rng, n, n, 4, 8, 5) + 1.1 * v - 0.9 * np.abs(u - 0.5) - 0.45
    return np.clip(np.stack([heat * 2.6, heat * 1.5 - 0.25, heat * 0.9 - 0.5], -1), 0.01, 1)


def _sky(rng: Generator, n: int, sky: tuple[str, ...]) -> Array:
    if len(sky) != 2:
        raise ValueError(f"sky: expected two colours, top and horizon, found {len(sky)}")
    top, horizon = palette(sky)
    v, _ = coordinates(n)
    out = mix(top, horizon, np.clip(v * 1.6, 0, 1))
    cloud = 0.8 * np.clip((fractal_noise(rng, n, n, 6, 3, 6) - 0.52) * 4, 0, 1) * (v < 0.5)
    return out * (1 - cloud[..., None]) + cloud[..., None]


def _sun(rng: Generator, n: int) -> Array:
    v, u = coordinates(n)
    cu, cv = 0.2 + 0.6 * rng.random(), 0.15 + 0.2 * rng.random()
    return rgb("#fff3c8") * np.exp(-((u - cu) ** 2 + (v - cv) ** 2) / 0.006)[..., None]


def landscape(
    rng: Generator,
    n: int,
    *,
    sky: tuple[str, ...] = ("#5f9fd6", "#f6dfbf"),
    hills: int = 5,
    ground: str = "#3f6b35",
    far: str = "#8fa9b8",
) -> Array:
    """Ridges of hills, one behind the other, from the colour ``far`` to the near ``ground``."""
    v, _ = coordinates(n)
    out = np.maximum(_sky(rng, n, sky), _sun(rng, n))
    for hill in range(hills):
        near = hill / max(1, hills - 1)
        ridge = fractal_noise(rng, 1, n, 1, 3 + 2 * hill, 6)[0] - 0.5
        line = 0.42 + 0.42 * near + (0.32 - 0.16 * near) * ridge
        rough = 0.75 + 0.5 * fractal_noise(rng, n, n, 20 + 20 * hill, 20 + 20 * hill, 3)
        color = mix(rgb(far), rgb(ground), np.full((n, n), near)) * rough[..., None]
        out = np.where((v > line)[..., None], color, out)
    return np.clip(out, 0, 1)


def skyline(
    rng: Generator,
    n: int,
    *,
    sky: tuple[str, ...] = ("#6f9fce", "#f3e2cf"),
    colors: tuple[str, ...] = ("#8a8f98", "#a8826a", "#6b7a86"),
    lit: float = 0.3,
) -> Array:
    """Houses with windows in three rows, one behind the other; ``lit`` is the fraction of windows with light."""
    v, u = coordinates(n)
    out = _sky(rng, n, sky)
    choices, haze = palette(colors), rgb(sky[-1])
    for row, base in enumerate((0.45, 0.58, 0.72)):
        x = -rng.uniform(0, 0.1)
        while x < 1:
            width, top = rng.uniform(0.08, 0.2), base - rng.uniform(0.0, 0.25)
            house = (u > x) & (u < x + width) & (v > top)
            wall = choices[rng.integers(len(choices))] * rng.uniform(0.7, 1.1)
            out[house] = haze * (0.5 - 0.25 * row) + wall * (0.5 + 0.25 * row)
            columns = max(2, int(width * 40))
            across, down = (u - x) / width * columns, (v - top) * 28
            pane = house & (across % 1 > 0.3) & (across % 1 < 0.75) & (down % 1 > 0.35) & (down % 1 < 0.85)
            alight = rng.random((32, columns))[down.astype(int) % 32, across.astype(int) % columns] < lit
            out[pane] = rgb("#39424e")
            out[pane & alight] = rgb("#ffe9a8")
            x += width + rng.uniform(0, 0.02)
    return np.clip(out, 0, 1)


def sea(
    rng: Generator,
    n: int,
    *,
    sky: tuple[str, ...] = ("#4d8fcb", "#fbe8cf"),
    water: str = "#1f6f8b",
    shore: str = "#d8c08a",
) -> Array:
    """The sea to the horizon, a beach in front, a few sails."""
    v, u = coordinates(n)
    out = np.maximum(_sky(rng, n, sky), _sun(rng, n))
    horizon = rng.uniform(0.42, 0.52)
    waves = fractal_noise(rng, n, n, 64, 6, 3)
    depth = np.clip((v - horizon) / (1 - horizon), 0, 1)
    surface = mix(rgb(water), rgb(sky[-1]), np.clip(0.55 * (1 - depth) ** 3 + 0.5 * (waves - 0.5), 0, 1))
    out = np.where((v > horizon)[..., None], surface, out)
    for _ in range(int(rng.integers(1, 4))):
        cu, foot, high = rng.uniform(0.1, 0.9), horizon + rng.uniform(0.01, 0.08), rng.uniform(0.05, 0.12)
        rise = (foot - v) / high
        out[(rise > 0) & (rise < 1) & (u > cu) & (u < cu + 0.4 * high * (1 - rise))] = rgb("#f7f4ec")
    beach = 0.8 + 0.12 * (fractal_noise(rng, 1, n, 1, 3, 4)[0] - 0.5)
    sand = rgb(shore) * (0.8 + 0.4 * fractal_noise(rng, n, n, 48, 48, 3))[..., None]
    out = np.where((v > beach)[..., None], sand, out)
    return np.clip(np.where((np.abs(v - beach) < 0.008)[..., None], 0.95, out), 0, 1)
