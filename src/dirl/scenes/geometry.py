"""Positions and directions of the states of a scene on its map, inferred from its moves."""

import numpy as np
from numpy.typing import NDArray

from dirl.scenes.graph import AHEAD, IntArray
from dirl.scenes.scene import Scene


def step_length(scene: Scene) -> float:
    """Return the median length of the moves ahead, metres; 0.5 where there are none."""
    _, moves = _moves_ahead(scene)
    return float(np.median(np.abs(moves))) if len(moves) else 0.5


def heading_directions(scene: Scene) -> NDArray[np.float64]:
    """Return where each state's heading points to on the map: unit vectors (x, z), float64 ``[N, 2]``.

    Headings are clockwise from +z in AI2-THOR, but other files may differ. The sense of rotation and its zero are
    therefore those that agree best with the moves ahead; where the moves leave it open, those of AI2-THOR.
    """
    states, moves = _moves_ahead(scene)
    clockwise = np.exp(1j * np.deg2rad(scene.headings))
    turned, zero = clockwise, np.complex128(1)
    if len(moves):
        # Where a sense fits, every move asks for the same zero; where it does not, they cancel each other out.
        fits = [(sense, np.mean(moves / sense[states])) for sense in (clockwise, clockwise.conj())]
        best, mean = max(fits, key=lambda fit: round(abs(fit[1]), 6))
        # With headings that are all the same the moves may cancel out in either sense.
        if abs(mean) > 1e-6 * np.abs(moves).max():
            turned, zero = best, mean / abs(mean)
    pointing = turned * zero
    return np.stack([pointing.imag, pointing.real], 1)


def _moves_ahead(scene: Scene) -> tuple[IntArray, NDArray[np.complex128]]:
    """Return the states whose way ahead is free, and the moves as z + ix, whose angle is the clockwise one from +z."""
    states = np.flatnonzero(scene.graph[:, AHEAD] >= 0)
    x, z = (scene.positions[scene.graph[states, AHEAD]] - scene.positions[states]).T
    return states, z + 1j * x
