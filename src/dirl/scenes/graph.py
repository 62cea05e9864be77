"""Properties of a scene's graph: distances, turns, places.

A graph is an integer array ``[N, 4]``: ``graph[state, action]`` is the next state, -1 where the move is blocked.
"""

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray


class Action(IntEnum):
    """What an agent does in a step, in the order of every graph in memory; right and left are turns on the spot."""

    ahead = 0
    right = 1
    left = 2
    back = 3


ACTIONS = tuple(action.name for action in Action)
"""The names of the actions, in their order (that of the published dumps)."""

AHEAD, RIGHT, LEFT, BACK = range(4)

ORDER_HINT = f"are the columns in the order {list(ACTIONS)}? (another one is declared by the file attribute 'actions')"

MAX_TURNS = 360
"""In a full circle; a ring of more states is no turn on the spot."""

IntArray = NDArray[np.int64]


class GraphError(ValueError):
    """An invalid graph; the message names the first offending state."""


def check_graph(graph: IntArray) -> None:
    """Check that next states exist and that turns form rings of equal length.

    Args:
        graph: next states, int64 ``[N, 4]``, -1 = blocked.

    Raises:
        GraphError: a next state is out of range, a right turn is not undone by the left turn, or the states that
            a full turn passes are not a multiple of four, the same everywhere. States without any move ("dead"
            states, as an isolated block of a published scene may have) need no turns.
    """
    states = len(graph)
    if states == 0:
        raise GraphError("there are no states")
    bad = np.argwhere((graph < -1) | (graph >= states))
    if len(bad):
        state, action = bad[0]
        raise GraphError(
            f"state {state}: {ACTIONS[action]} leads to state {graph[state, action]}, "
            f"but states are 0..{states - 1} (and -1 for a blocked move)"
        )
    alive = np.flatnonzero((graph >= 0).any(1))
    if len(alive) == 0:
        raise GraphError("state 0: no state has any move")
    turned = graph[alive, RIGHT]
    bad = alive[turned < 0]
    if len(bad):
        raise GraphError(f"state {bad[0]}: turning right is blocked, as a turn on the spot never is; {ORDER_HINT}")
    # With this the left turn is the inverse of the right turn everywhere, and needs no check of its own.
    bad = alive[graph[turned, LEFT] != alive]
    if len(bad):
        raise GraphError(f"state {bad[0]}: turning right and back does not return to it; {ORDER_HINT}")
    rings = np.zeros(len(alive), np.int64)  # how many right turns bring each state back; 0 = more than MAX_TURNS
    at = alive
    for turns in range(1, MAX_TURNS + 1):
        at = graph[at, RIGHT]
        rings[(at == alive) & (rings == 0)] = turns
        if rings.all():
            break
    odd = alive[(rings % 4 != 0) | (rings != rings[0]) | (rings == 0)]
    if len(odd):
        here, first = (length or f"more than {MAX_TURNS}" for length in (rings[alive == odd[0]][0], rings[0]))
        raise GraphError(
            f"state {odd[0]}: a full turn to the right passes {here} states; "
            f"expected the same multiple of four everywhere ({first} at state {alive[0]})"
        )


def turns_per_circle(graph: IntArray) -> int:
    """Return the right turns in a full circle of a checked graph: 4 if a turn is 90 degrees, 12 if it is 30."""
    first = np.argmax((graph >= 0).any(1))  # the first state that has moves
    state, turns = graph[first, RIGHT], 1
    while state != first:
        state, turns = graph[state, RIGHT], turns + 1
    return turns


def turns_only(places: int, headings: int) -> IntArray:
    """Return next states of so many places with so many headings each, int64 ``[P * K, 4]``: moves are blocked."""
    state = np.arange(places * headings)
    heading = state % headings
    graph = np.full((len(state), len(ACTIONS)), -1, np.int64)
    graph[:, RIGHT] = state - heading + (heading + 1) % headings
    graph[:, LEFT] = state - heading + (heading - 1) % headings
    return graph


def places(graph: IntArray) -> IntArray:
    """Return the place of each state, int64 ``[N]``: states that are connected by turns share one.

    Places are numbered 0, 1, ... in the order of their first states.
    """
    first = np.arange(len(graph))
    right = np.where(graph[:, RIGHT] >= 0, graph[:, RIGHT], first)
    for _ in range(turns_per_circle(graph)):
        first = np.minimum(first, first[right])
    return np.unique(first, return_inverse=True)[1]


def shortest_distances(graph: IntArray, goals: IntArray | None = None) -> NDArray[np.int32]:
    """Return the fewest actions from every state to each goal.

    Args:
        graph: a checked graph, int64 ``[N, 4]``.
        goals: goal states, int64 ``[G]``; all states if left out.

    Returns:
        int32 ``[N, G]``, -1 where the goal cannot be reached.
    """
    from scipy.sparse import csr_array  # here: the process that reads dumps does without, and this takes half a second
    from scipy.sparse.csgraph import dijkstra

    state, action = np.nonzero(graph >= 0)
    backwards = csr_array((np.ones(len(state)), (graph[state, action], state)), (len(graph), len(graph)))
    distances = dijkstra(backwards, unweighted=True, indices=goals)
    distances[np.isinf(distances)] = -1
    return distances.T.astype(np.int32, order="C")
