"""Textures with one image each: paintings, rugs, book spines, a fire, and what a window or a screen shows."""

from itertools import pairwise

import numpy as np

from dirl.sources.rooms.textures.noise import Array, Canvas, fractal_noise, mix, palette, rgb


def abstract(
    c: Canvas, *, colors: tuple[str, ...] = ("#d94f30", "#f2c14e", "#2a6f97", "#f4f1de", "#22223b"), cells: int = 14
) -> Array:
    """Draw fields of colour around random points, leaded like a church window."""
    points = c.rng.random((max(2, cells), 2))
    distance = np.hypot(c.u[..., None] - points[:, 0], c.v[..., None] - points[:, 1])
    nearest = np.partition(distance, 1, -1)
    fields = palette(colors)[c.rng.integers(len(colors), size=len(points))]
    out = fields[distance.argmin(-1)] * (0.85 + 0.3 * c.noise(24, 24, 3)[..., None])
    out[(nearest[..., 1] - nearest[..., 0]) < 0.012] = 0.06
    return np.clip(out, 0, 1)


def blocks(c: Canvas, *, colors: tuple[str, ...] = ("#c8102e", "#f6d000", "#0b4ea2", "#f5f3ea")) -> Array:
    """Draw rectangles between black lines; the last colour is the ground."""
    choices = palette(colors)
    xs, ys = (np.r_[0, np.sort(c.rng.uniform(0.1, 0.9, 4)), 1] for _ in range(2))
    out = np.full((c.n, c.n, 3), choices[-1])
    for x0, x1 in pairwise(xs):
        for y0, y1 in pairwise(ys):
            if c.rng.random() < 0.45:
                inside = (c.u > x0) & (c.u < x1) & (c.v > y0) & (c.v < y1)
                out[inside] = choices[c.rng.integers(max(1, len(choices) - 1))]
    for x, y in zip(xs, ys, strict=True):
        out[(np.abs(c.u - x) < 0.012) | (np.abs(c.v - y) < 0.012)] = 0.05
    return out


def circles(
    c: Canvas, *, colors: tuple[str, ...] = ("#e4572e", "#17bebb", "#ffc914", "#2e282a", "#76b041"), cells: int = 3
) -> Array:
    """Draw concentric rings of colour in a grid of squares."""
    row, column = np.floor(c.v * cells).astype(int), np.floor(c.u * cells).astype(int)
    radius = np.hypot((c.u * cells) % 1 - 0.5, (c.v * cells) % 1 - 0.5)
    ring = np.minimum((radius * 8.5).astype(int), 4)
    choice = c.rng.integers(len(colors), size=(cells, cells, 5))[row, column, ring]
    return np.clip(palette(colors)[choice] * (0.85 + 0.3 * c.noise(16, 16, 4)[..., None]), 0, 1)


def bouquet(
    c: Canvas, *, ground: str = "#2f3e46", colors: tuple[str, ...] = ("#e76f51", "#f4a261", "#e9c46a", "#fefae0")
) -> Array:
    """Draw flowers in a vase, loosely painted."""
    out = rgb(ground) * (0.7 + 0.6 * c.noise(4, 4, 5))[..., None]
    out[c.v > 0.82] *= 0.6
    choices = palette(colors)
    flowers = 16
    for _ in range(2 * flowers):  # foliage behind the flowers
        cu, cv, angle = c.rng.normal(0.5, 0.2), c.rng.normal(0.42, 0.16), c.rng.random() * np.pi
        p, q = (
            (c.u - cu) * np.cos(angle) + (c.v - cv) * np.sin(angle),
            (c.v - cv) * np.cos(angle) - (c.u - cu) * np.sin(angle),
        )
        out[(p / 0.11) ** 2 + (q / 0.03) ** 2 < 1] = rgb("#4f772d") * c.rng.uniform(0.5, 1.1)
    out[(c.v > 0.62) & (c.v < 0.9) & (np.abs(c.u - 0.5) < 0.12 + 0.06 * np.sin((c.v - 0.62) * 9))] = choices[-1] * 0.85
    for _ in range(flowers):
        cu, cv, size = c.rng.normal(0.5, 0.17), c.rng.normal(0.38, 0.13), c.rng.uniform(0.05, 0.1)
        r, around = np.hypot(c.u - cu, c.v - cv), np.arctan2(c.v - cv, c.u - cu)
        petals = r < size * (0.75 + 0.25 * np.cos(c.rng.integers(5, 9) * around))
        color = choices[c.rng.integers(len(choices))]
        out[petals] = color * (0.6 + 0.4 * np.minimum(r[petals] / size, 1))[:, None]
        out[r < 0.25 * size] = rgb("#5c3d1e")
    return np.clip(out, 0, 1)


def rug(c: Canvas, *, colors: tuple[str, ...] = ("#7a1f1f", "#d8b26e", "#1f3a5f", "#efe3c8")) -> Array:
    """Draw a carpet with a star in a border; the colours are field, ornament, border and lines."""
    field, ornament, border, line = _four(colors)
    x, y = np.abs(c.u - 0.5) * 2, np.abs(c.v - 0.5) * 2
    edge = np.maximum(x, y)
    out = np.full((c.n, c.n, 3), field)
    out[edge > 0.72] = border
    zigzag = np.abs((np.where(x > y, y, x) * 9) % 1 - 0.5)
    out[(edge > 0.76) & (edge < 0.92) & (np.abs(edge - 0.84) < 0.07 * (1 - 2 * zigzag) + 0.01)] = ornament
    out[(np.abs(edge - 0.72) < 0.015) | (np.abs(edge - 0.95) < 0.012)] = line
    r, angle = np.hypot(x, y), np.arctan2(y, x)
    star = 0.38 + 0.12 * np.cos(8 * angle)
    out[(r < star) & (edge < 0.7)] = ornament
    out[(r < star * 0.75) & (edge < 0.7)] = border
    out[r < 0.14 + 0.05 * np.cos(6 * angle)] = line
    return np.clip(out * (0.8 + 0.4 * c.noise(64, 64, 3))[..., None], 0, 1)


def kilim(c: Canvas, *, colors: tuple[str, ...] = ("#a23e2a", "#e5c687", "#2d4a58", "#f0e6d2"), rows: int = 5) -> Array:
    """Draw a flat-woven rug: bands of stepped diamonds, each band in its own colours."""
    choices = _four(colors)
    out = np.empty((c.n, c.n, 3))
    band = np.minimum((c.v * rows).astype(int), rows - 1)
    for k in range(rows):
        ground, shape = c.rng.permutation(4)[:2]
        count = int(c.rng.integers(3, 8))
        x, y = np.abs((c.u * count) % 1 - 0.5) * 2, np.abs((c.v * rows) % 1 - 0.5) * 2
        stepped = np.floor((x + y) * 5) / 5
        part = np.where((stepped < 0.8)[..., None], choices[shape], choices[ground])
        part = np.where((stepped < 0.35)[..., None], choices[ground], part)
        out[band == k] = part[band == k]
    out[np.abs(c.v * rows - np.round(c.v * rows)) < 0.05] = choices[3]
    return np.clip(out * (0.8 + 0.4 * c.noise(64, 64, 3))[..., None], 0, 1)


def _four(colors: tuple[str, ...]) -> Array:
    if len(colors) != 4:
        raise ValueError(f"colors: expected four of them, found {len(colors)}")
    return palette(colors)


def books(c: Canvas) -> Array:
    """Draw a row of book spines."""
    out = np.full((c.n, c.n, 3), 0.08)
    x = 0
    while x < c.n:
        width, top = int(c.rng.integers(max(2, c.n // 36), max(4, c.n // 14))), int(c.n * c.rng.uniform(0.02, 0.25))
        color = c.rng.random(3) * 0.6 + 0.12
        spine = out[top:, x : x + width - 1]
        spine[:] = color
        band = int(len(spine) * c.rng.uniform(0.12, 0.3))
        spine[band : band + max(2, c.n // 24)] = 0.85 * np.clip(color[::-1] + 0.3, 0, 1)
        spine[:, : max(1, width // 10)] *= 0.7
        x += width
    return out


def fire(c: Canvas) -> Array:
    """Draw flames, brightest at the bottom."""
    heat = c.noise(4, 8, 5) + 1.1 * c.v - 0.9 * np.abs(c.u - 0.5) - 0.45
    return np.clip(np.stack([heat * 2.6, heat * 1.5 - 0.25, heat * 0.9 - 0.5], -1), 0.01, 1)


def _sky(c: Canvas, sky: tuple[str, ...]) -> Array:
    if len(sky) != 2:
        raise ValueError(f"sky: expected two colours, top and horizon, found {len(sky)}")
    top, horizon = palette(sky)
    out = mix(top, horizon, np.clip(c.v * 1.6, 0, 1))
    cloud = 0.8 * np.clip((c.noise(6, 3, 6) - 0.52) * 4, 0, 1) * (c.v < 0.5)
    return out * (1 - cloud[..., None]) + cloud[..., None]


def _sun(c: Canvas) -> Array:
    cu, cv = 0.2 + 0.6 * c.rng.random(), 0.15 + 0.2 * c.rng.random()
    return rgb("#fff3c8") * np.exp(-((c.u - cu) ** 2 + (c.v - cv) ** 2) / 0.006)[..., None]


def landscape(
    c: Canvas,
    *,
    sky: tuple[str, ...] = ("#5f9fd6", "#f6dfbf"),
    hills: int = 5,
    ground: str = "#3f6b35",
    far: str = "#8fa9b8",
) -> Array:
    """Draw ridges of hills, one behind the other, from the colour ``far`` to the near ``ground``."""
    out = np.maximum(_sky(c, sky), _sun(c))
    for hill in range(hills):
        near = hill / max(1, hills - 1)
        ridge = fractal_noise(c.rng, 1, c.n, 1, 3 + 2 * hill, 6)[0] - 0.5
        line = 0.42 + 0.42 * near + (0.32 - 0.16 * near) * ridge
        rough = 0.75 + 0.5 * c.noise(20 + 20 * hill, 20 + 20 * hill, 3)
        color = mix(rgb(far), rgb(ground), np.full((c.n, c.n), near)) * rough[..., None]
        out = np.where((c.v > line)[..., None], color, out)
    return np.clip(out, 0, 1)


def skyline(
    c: Canvas,
    *,
    sky: tuple[str, ...] = ("#6f9fce", "#f3e2cf"),
    colors: tuple[str, ...] = ("#8a8f98", "#a8826a", "#6b7a86"),
) -> Array:
    """Draw houses with windows in three rows, one behind the other, a few of them with light."""
    out = _sky(c, sky)
    choices, haze = palette(colors), rgb(sky[-1])
    for row, base in enumerate((0.45, 0.58, 0.72)):
        x = -c.rng.uniform(0, 0.1)
        while x < 1:
            width, top = c.rng.uniform(0.08, 0.2), base - c.rng.uniform(0.0, 0.25)
            house = (c.u > x) & (c.u < x + width) & (c.v > top)
            wall = choices[c.rng.integers(len(choices))] * c.rng.uniform(0.7, 1.1)
            out[house] = haze * (0.5 - 0.25 * row) + wall * (0.5 + 0.25 * row)
            columns = max(2, int(width * 40))
            across, down = (c.u - x) / width * columns, (c.v - top) * 28
            pane = house & (across % 1 > 0.3) & (across % 1 < 0.75) & (down % 1 > 0.35) & (down % 1 < 0.85)
            alight = c.rng.random((32, columns))[down.astype(int) % 32, across.astype(int) % columns] < 0.3
            out[pane] = rgb("#39424e")
            out[pane & alight] = rgb("#ffe9a8")
            x += width + c.rng.uniform(0, 0.02)
    return np.clip(out, 0, 1)


def sea(
    c: Canvas, *, sky: tuple[str, ...] = ("#4d8fcb", "#fbe8cf"), water: str = "#1f6f8b", shore: str = "#d8c08a"
) -> Array:
    """Draw the sea to the horizon, a beach in front, a few sails."""
    out = np.maximum(_sky(c, sky), _sun(c))
    horizon = c.rng.uniform(0.42, 0.52)
    waves = c.noise(64, 6, 3)
    depth = np.clip((c.v - horizon) / (1 - horizon), 0, 1)
    surface = mix(rgb(water), rgb(sky[-1]), np.clip(0.55 * (1 - depth) ** 3 + 0.5 * (waves - 0.5), 0, 1))
    out = np.where((c.v > horizon)[..., None], surface, out)
    for _ in range(int(c.rng.integers(1, 4))):
        cu, foot, high = c.rng.uniform(0.1, 0.9), horizon + c.rng.uniform(0.01, 0.08), c.rng.uniform(0.05, 0.12)
        rise = (foot - c.v) / high
        out[(rise > 0) & (rise < 1) & (c.u > cu) & (c.u < cu + 0.4 * high * (1 - rise))] = rgb("#f7f4ec")
    beach = 0.8 + 0.12 * (fractal_noise(c.rng, 1, c.n, 1, 3, 4)[0] - 0.5)
    sand = rgb(shore) * (0.8 + 0.4 * c.noise(48, 48, 3))[..., None]
    out = np.where((c.v > beach)[..., None], sand, out)
    return np.clip(np.where((np.abs(c.v - beach) < 0.008)[..., None], 0.95, out), 0, 1)
