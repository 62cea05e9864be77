"""What is seen through a window, on a screen or in a frame: landscapes, a town, the sea."""

import numpy as np

from dirl.rooms.textures.noise import Array, coordinates, fractal_noise, mix, palette, rgb

Generator = np.random.Generator


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
