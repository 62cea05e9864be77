"""A walk through a scene that makes a map of it: the walker goes where something is still unknown."""

from collections.abc import Callable

import torch
from torch import Tensor

from dirl.agent.mapping.graph import ImageGraph
from dirl.scenes.graph import IntArray
from dirl.scenes.scene import Scene


def explore(
    scene: Scene, graph: ImageGraph, start: int, steps: int, look: Callable[[int], Tensor] | None = None
) -> list[int]:
    """Walk through a scene and map it; the walk ends early where nothing is left to be learnt.

    The walker knows what it sees and does, never the scene's graph or the numbers of states.

    Args:
        scene: where.
        graph: empty; filled by the walk.
        start: the first state.
        steps: of the walk, at most.
        look: the features ahead, right, back and left of a state, float32 ``[4, D]``; the scene's own if left out.

    Returns:
        The states that were passed.
    """
    look = look or looks(scene)
    passed, node = [start], graph.see(look(start))
    for _ in range(steps):
        action = graph.frontier_action(node)
        if action is None:
            break
        passed.append(step(scene.graph, passed[-1], action))
        node = graph.see(look(passed[-1]), action)
    return passed


def looks(scene: Scene, features: Tensor | None = None) -> Callable[[int], Tensor]:
    """What is seen around each state: float32 ``[4, D]`` of the scene's features, or of others, ``[N, D]``."""
    if features is None:
        assert scene.features is not None
        features = torch.tensor(scene.features, dtype=torch.float32)
    surrounding = torch.tensor(scene.surrounding)
    return lambda state: features[surrounding[state]]


def step(moves: IntArray, state: int, action: int) -> int:
    """The state after an action; a blocked one leaves it."""
    there = int(moves[state, action])
    return state if there < 0 else there
