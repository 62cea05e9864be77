"""A walk through a scene that makes a map of it: the walker goes where something is still unknown."""

from collections.abc import Callable
from typing import Any, Protocol

import torch
from torch import Tensor

from dirl.scenes.graph import IntArray
from dirl.scenes.scene import Scene


class Mapper(Protocol):
    """What makes a map of a walk: `dirl.agent.mapping.ImageGraph` or `dirl.agent.mapping.places.ParticleMapper`."""

    def see(self, views: Tensor, action: int | None = None) -> Any:
        """Take in what is seen ahead, right, back and left, ``[4, ...]``, after an action."""

    def frontier_action(self) -> int | None:
        """Return the action that leads soonest to something unknown; None if nothing in reach is unknown."""


def explore(
    scene: Scene, graph: Mapper, start: int, steps: int, look: Callable[[int], Tensor] | None = None
) -> list[int]:
    """Fill an empty map by a walk; return the states passed. It ends early where nothing is left to be learned.

    The walker knows what it sees and does, never the scene's graph or the numbers of states. ``look`` tells what is
    seen ahead, right, back and left of a state, in the form that the map takes, ``[4, ...]``; the scene's features,
    float32 ``[4, D]``, if left out.
    """
    look = look or torch.tensor(scene.features)[torch.tensor(scene.surrounding)].__getitem__
    passed = [start]
    graph.see(look(start))
    for _ in range(steps):
        action = graph.frontier_action()
        if action is None:
            break
        passed.append(step(scene.graph, passed[-1], action))
        graph.see(look(passed[-1]), action)
    return passed


def step(moves: IntArray, state: int, action: int) -> int:
    """Return the state after an action; a blocked one leaves it as it was."""
    there = int(moves[state, action])
    return state if there < 0 else there
