"""Whether a place that looks like a known one is that place: decided by the neighbour that the next move reaches.

After an observation that matches known nodes, reached by an unknown edge, the walker may be in one of them, or in
another place that looks the same (perceptual aliasing). A panorama is made for it, and for each of these candidates it
is tracked where the walker would be. If a move leads to where the candidate's neighbour is seen, that candidate and
the new panorama are merged; if it leads to something else, they are not: that would be a false loop closure. Where the
map knows too little to decide, the match is believed.
"""

from collections import deque
from collections.abc import Mapping
from typing import Protocol

from torch import Tensor

from dirl.agent.mapping.looks import UNKNOWN, VIEWS, turned
from dirl.scenes.graph import AHEAD, BACK


class Walked(Protocol):
    """What is asked of a map here, see `dirl.agent.mapping.ImageGraph`."""

    moves: list[list[int]]
    at: int | None
    doubt: "Doubt | None"

    def scores(self, views: Tensor) -> Tensor: ...  # noqa: D102

    def fits(self, scores: Tensor, node: int) -> bool: ...  # noqa: D102

    def add_station(self, views: Tensor) -> int: ...  # noqa: D102

    def merge_stations(self, same: Mapping[int, int]) -> None: ...  # noqa: D102

    def record(self, before: int | None, action: int | None, node: int) -> None: ...  # noqa: D102


class Doubt:
    """A match that is not believed yet.

    Args:
        node: the first of the new panorama.
        candidates: the nodes that looked like it, the most alike first.
    """

    def __init__(self, node: int, candidates: list[int]) -> None:
        self.candidates = candidates
        """Where the walker is now, for each."""
        self.same = [_pairs(node, candidate) for candidate in candidates]
        """For each, which nodes those of the panoramas made since would be."""

    def testing_action(self, graph: Walked) -> int | None:
        """The first action on a shortest path to a neighbour of the best candidate; None if it has none."""
        first: dict[int, int | None] = {self.candidates[0]: None}
        queue = deque(first)
        while queue:
            here = queue.popleft()
            for action, there in enumerate(graph.moves[here]):
                if there == UNKNOWN or there in first or there in self.same[0]:
                    continue
                began = action if first[here] is None else first[here]
                if action in (AHEAD, BACK):
                    return began
                first[there] = began
                queue.append(there)
        return None

    def keep(self, chosen: list[int]) -> None:
        """Leave these candidates, by their places in the list."""
        self.candidates = [self.candidates[i] for i in chosen]
        self.same = [self.same[i] for i in chosen]


def settle(graph: Walked, views: Tensor, action: int) -> bool:
    """See on while in doubt.

    Args:
        graph: with a doubt, which ends with most moves.
        views: of what is seen after the action, float32 ``[4, D]``.
        action: what was done.

    Returns:
        Whether it was seen to the end: the walker is where `ImageGraph.at` says. Else it is to be seen as ever.
    """
    doubt = graph.doubt
    assert doubt is not None
    assert graph.at is not None
    scores = graph.scores(views)
    after = [graph.moves[node][action] for node in doubt.candidates]
    fitting = [i for i, node in enumerate(after) if node != UNKNOWN and graph.fits(scores, node)]
    told = [i for i in fitting if action in (AHEAD, BACK) and after[i] != doubt.candidates[i]]
    unknown = [i for i, node in enumerate(after) if node == UNKNOWN]
    if told or not fitting:
        graph.doubt = None
        if told or unknown:
            best = max(told, key=lambda i: float(scores[after[i]])) if told else unknown[0]
            graph.merge_stations(doubt.same[best])
        return False
    doubt.keep(fitting)
    after = [after[i] for i in fitting]
    back = [new for new, old in doubt.same[0].items() if old == after[0]]
    here = back[0] if back else graph.add_station(views)
    for same, node in zip(doubt.same, after, strict=True):
        same.update({} if back else _pairs(here, node))
    graph.record(graph.at, action, here)
    graph.at, doubt.candidates = here, after
    return True


def _pairs(new: int, old: int) -> dict[int, int]:
    """The nodes of a panorama ``new``, each with the node of the panorama of ``old`` that it would be."""
    return {new + k: turned(old, k) for k in range(VIEWS)}
