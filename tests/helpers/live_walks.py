"""A walk in a live world beside the same walk in its dump."""

from typing import NamedTuple

import numpy as np

from dirl.scenes.live import Dumped, Simulated, state_pose


class Walk(NamedTuple):
    differ: int
    """Moves that were blocked in one of the two only."""
    apart: float
    """The largest distance between the two agents, metres."""
    off: list[float]
    """Of each step the mean difference of the four views, of 255."""
    own: int
    """Steps in which the view ahead is nearest to that of the dump's own state, among those of all its states."""


def walk(simulator, scene, step, turns, moves, seed=0):
    """Random moves in both, from a random state."""
    live, dumped = Simulated(simulator, step=step, turns=turns), Dumped(scene)
    small = np.stack([scene.views[state][::4, ::4] for state in range(len(scene))]).astype(np.int16)
    draws = np.random.default_rng(seed)
    first = state_pose(scene, int(draws.integers(len(scene))))
    for world in (live, dumped):
        world.reset(first)
    differ, off, apart, own = 0, [], 0.0, 0
    for action in draws.choice(4, moves, p=(0.4, 0.2, 0.2, 0.2)).tolist():
        differ += live.step(action) != dumped.step(action)
        apart = max(apart, float(np.hypot(*np.subtract(live.pose[:2], dumped.pose[:2]))))
        views = live.views()
        off.append(float(np.abs(views.astype(float) - dumped.views()).mean()))
        distance = np.abs(small - views[0, ::4, ::4]).mean((1, 2, 3))
        own += int(distance[dumped.state] == distance.min())
    return Walk(differ, apart, off, own)
