"""A walk through a scene that makes a map of it: the walker goes where something is still unknown."""

import torch
from torch import Tensor

from dirl.mapping.graph import ImageGraph
from dirl.scenes.graph import IntArray
from dirl.scenes.scene import Scene


def explore(
    scene: Scene, graph: ImageGraph, start: int, steps: int, features: Tensor | None = None
) -> tuple[list[int], list[int]]:
    """Walk through a scene and map it; the walk ends early where nothing is left to be learnt.

    The walker knows what it sees and does, never the scene's graph or the numbers of states.

    Args:
        scene: where.
        graph: empty; filled by the walk.
        start: the first state.
        steps: of the walk, at most.
        features: what is seen from each state, float32 ``[N, D]``; the scene's own if left out.

    Returns:
        The states that were passed, and the node that the map took each for.
    """
    if features is None:
        assert scene.features is not None
        features = torch.tensor(scene.features, dtype=torch.float32)
    surrounding = torch.tensor(scene.surrounding)
    state, passed, nodes = start, [start], [graph.see(features[surrounding[start]])]
    for _ in range(steps):
        action = graph.frontier_action(nodes[-1])
        if action is None:
            break
        state = step(scene.graph, state, action)
        passed.append(state)
        nodes.append(graph.see(features[surrounding[state]], action))
    return passed, nodes


def step(moves: IntArray, state: int, action: int) -> int:
    """The state after an action; a blocked one leaves it."""
    there = int(moves[state, action])
    return state if there < 0 else there
