"""How two panoramas are turned against each other, from what they show.

A column of a panorama is what lies in one direction. If panorama j stands in a known direction from panorama i, a thing
at a supposed distance in a column of i is seen from j in another column, larger or smaller. For each turn between the
two images every column takes the distance at which it looks most like its counterpart; the turn at which the columns of
both images agree best is the one (plane sweeping; the distance between the panoramas is the unit).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dirl.sources.tours.pixels import Cube, Equirectangular, read_panorama, sample

COLUMNS, ROWS = 360, 64
"""Columns and rows of a panorama that is compared."""

HIGHEST, LOWEST = 1.0, -1.3
"""Tangents of the angles above the horizon between which rows are spread evenly: a thing's grow by its nearness."""

SCALES = np.exp(np.linspace(-1, 1, 17))
"""How much larger things may be in the other panorama."""

DISTANCES = np.exp(np.linspace(np.log(0.3), np.log(8), 24))
"""Distances of things that are tried, in distances between the two panoramas."""

COARSE, FINE = 2.0, 0.5
"""Degrees between the turns that are tried, everywhere and around the best."""

RIVAL, PEAK = 20.0, 5.0
"""Degrees from the best turn on, another one contradicts it; and another peak makes it doubtful."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Seen:
    """What two panoramas show of their headings.

    Args:
        turn: the heading of the second less that of the first, degrees.
        lead: how much better they agree at that turn than at any rival, in standard deviations over all turns.
        peak: how much better than at the next peak, which may be nearer than rivals, likewise.
    """

    turn: float
    lead: float
    peak: float = np.inf


def columns(image: Equirectangular | Cube) -> Array:
    """Return how colours change in each column, clockwise from the one behind, float64 ``[COLUMNS, ROWS, 6]``.

    Three of the six are the changes downwards, three those clockwise: a wall between two others looks alike in many
    columns if only its upper and its lower edge tell.
    """
    yaw = np.radians((np.arange(COLUMNS) + 0.5) * 360 / COLUMNS - 180)
    up, yaws = np.meshgrid(np.linspace(HIGHEST, LOWEST, ROWS), yaw)
    directions = np.stack([np.sin(yaws), up, np.cos(yaws)])
    pixels = sample(read_panorama(image, COLUMNS / (2 * np.pi)), directions / np.linalg.norm(directions, axis=0))
    seen = pixels / 255.0
    return np.concatenate([np.gradient(seen, axis=1), (np.roll(seen, -1, 0) - np.roll(seen, 1, 0)) / 2], 2)


def compare(first: Array, second: Array, yaws: Sequence[float]) -> Seen:
    """Return how much two panoramas, given by their `columns`, are turned against each other.

    ``yaws`` are where the second may stand in the image of the first, degrees clockwise from its middle.
    """
    alike, alike_back = _alike(first, second), _alike(second, first)

    def agreement(yaw: float, turns: Array) -> Array:
        return _agreement(alike, yaw, turns) + _agreement(alike_back, yaw - turns + 180, -turns)

    turns = np.arange(-180, 180, COARSE)
    agreed = np.array([agreement(yaw, turns) for yaw in yaws])
    which, nearest = (int(index) for index in np.unravel_index(agreed.argmax(), agreed.shape))
    around = turns[nearest] + np.arange(-COARSE, COARSE + FINE, FINE)
    best = float(around[agreement(yaws[which], around).argmax()])
    at, off = agreed.max(0), np.abs((turns - best + 180) % 360 - 180)
    peaks = (at >= np.roll(at, 1)) & (at >= np.roll(at, -1)) & (off > PEAK)
    others = (at[there].max(initial=-np.inf) for there in (off > RIVAL, peaks))  # there may be no other peak
    lead, peak = ((at.max() - other) / (agreed[which].std() + 1e-9) for other in others)
    return Seen((best + 180) % 360 - 180, float(lead), float(peak))


def _alike(first: Array, second: Array) -> Array:
    """Correlate each column of one panorama, scaled, with each of another, ``[SCALES, COLUMNS, COLUMNS + 1]``.

    The last column is the first once more.
    """
    rows = np.linspace(HIGHEST, LOWEST, ROWS)
    alike = []
    for scale in SCALES:
        place = (rows / scale - HIGHEST) / (LOWEST - HIGHEST) * (ROWS - 1)
        inside = (place >= 0) & (place <= ROWS - 1)
        above = np.clip(place[inside].astype(int), 0, ROWS - 2)
        below = (place[inside] - above)[:, None]
        scaled = first[:, above] * (1 - below) + first[:, above + 1] * below
        matches = _normalised(scaled) @ _normalised(second[:, inside]).T
        alike.append(sum(np.roll(matches, (step, step), (0, 1)) for step in (-1, 0, 1)) / 3)
    scaled_matches = np.array(alike)
    return np.concatenate([scaled_matches, scaled_matches[:, :, :1]], 2)


def _normalised(values: Array) -> Array:
    flat = values.reshape(len(values), -1)
    flat = flat - flat.mean(1, keepdims=True)
    return np.asarray(flat / (np.linalg.norm(flat, axis=1, keepdims=True) + 1e-3))


AZIMUTHS = (np.arange(COLUMNS) + 0.5) * 360 / COLUMNS - 180
"""Directions of columns, degrees clockwise from the way to the other panorama."""

_RIGHT = DISTANCES[:, None] * np.sin(np.radians(AZIMUTHS))
_AHEAD = DISTANCES[:, None] * np.cos(np.radians(AZIMUTHS)) - 1
THERE = np.degrees(np.arctan2(_RIGHT, _AHEAD))
"""In which direction from the other panorama a thing lies, by distance and azimuth here, degrees."""

_GROWTH = np.log(DISTANCES[:, None] / np.hypot(_RIGHT, _AHEAD)) / np.log(SCALES[1] / SCALES[0]) + len(SCALES) // 2
SCALE = np.clip(_GROWTH.round().astype(int), 0, len(SCALES) - 1)
"""Which of `SCALES` it has there."""
TOO_NEAR = np.abs(_GROWTH - SCALE) > 0.75


def _agreement(alike: Array, yaws: Array | float, turns: Array) -> Array:
    """Return how well the columns of two panoramas agree, each with its best distance: at each turn, ``[T]``.

    It is the mean of cubes: some columns that agree well tell more than many that agree a little, as all do where
    the other panorama does not see what they show. ``yaws`` are where the second panorama stands in the image of the
    first, at each turn or at all of them.
    """
    agreed = []
    for yaw, turn in zip(*np.broadcast_arrays(yaws, turns), strict=True):
        here = np.round((AZIMUTHS + yaw + 180) * COLUMNS / 360 - 0.5).astype(int) % COLUMNS
        place = (THERE + yaw - turn + 180) * COLUMNS / 360 - 0.5
        left = np.floor(place)
        share = place - left
        # An index into all values at once: with one for each axis this takes twice as long.
        index = (SCALE * COLUMNS + here) * (COLUMNS + 1) + left.astype(int) % COLUMNS
        matched = alike.take(index) * (1 - share) + alike.take(index + 1) * share
        matched[TOO_NEAR] = -0.5
        agreed.append((np.maximum(matched.max(0), 0) ** 3).mean())
    return np.array(agreed)
