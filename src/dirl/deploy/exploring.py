"""A navigator with a map: a walk that makes one, and the way to a photo by it."""

from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor

from dirl.deploy.images import Images, NavigatorError
from dirl.mapping import ImageGraph, MapError, load_graph, save_graph

NO_WAY = 2**30
"""More steps than any way has."""


class Explorer:
    """A walk through a place, by a robot or a person, that makes a map of it. Made by `dirl.Navigator.explore`.

    Args:
        encode: images of four views to their features, float32 ``[4, D]``.
        graph: the map, empty or of an earlier walk.
        extractor: what makes the features, written into saved maps.
    """

    def __init__(self, encode: Callable[[Images], Tensor], graph: ImageGraph, extractor: str) -> None:
        self._encode, self.graph, self.extractor = encode, graph, extractor

    def see(self, images: Images, action: int | None = None) -> int:
        """Add what is seen now to the map: the node where the walker is.

        Args:
            images: uint8 RGB ``[4, H, W, 3]``, ahead, right, back and left.
            action: what the walker did since the images before (0 ahead, 1 right, 2 left, 3 back), also if it was
                blocked; None if it did nothing.

        Raises:
            NavigatorError: images of another shape or type, or an unknown action.
        """
        if action not in (None, 0, 1, 2, 3):
            raise NavigatorError(f"action={action!r}: expected 0 ahead, 1 right, 2 left, 3 back, or None")
        return self.graph.see(self._encode(images), action)

    def next_action(self) -> int | None:
        """The action after which most is learnt soonest; None if everything in reach is known, or nothing was seen."""
        return None if self.graph.at is None else self.graph.frontier_action(self.graph.at)

    def save(self, folder: str | Path) -> Path:
        """Write the map into a folder, see `dirl.mapping.save_graph`."""
        return save_graph(self.graph, folder, extractor=self.extractor)


class Guide:
    """The way to one goal by a map, followed step by step; what the map says wrongly is corrected on the way.

    Args:
        graph: the map; where the agent is in it is forgotten.
        goal_views: features of the goal's four views, float32 ``[4, D]``, or of one photo, ``[1, D]``.
        last_steps: within so many steps of the goal it gives no advice.
    """

    def __init__(self, graph: ImageGraph, goal_views: Tensor, last_steps: int) -> None:
        if not len(graph):
            raise NavigatorError("the map is empty; walk before it is used, see Navigator.explore")
        graph.lose()
        scores = graph.scores(goal_views)
        self.graph, self.last_steps = graph, last_steps
        self.goal = int(scores.argmax())
        """The node that looks most like the goal."""
        self.match = float(scores[self.goal])
        """How much it does, -1 to 1; a goal far from all that was seen has a low one."""
        self.goals = (scores > self.match - graph.margin / 2).nonzero().flatten().tolist()
        """All nodes that look like it nearly as much: in disturbed views the same place may be several nodes."""
        self.action: int | None = None
        self._planned: tuple[int, Tensor] = (-1, torch.empty(0))

    def advise(self, views: Tensor) -> int | None:
        """The next action by the map, for what is seen now, float32 ``[4, D]``; None where the policy shall decide."""
        node = self.graph.follow(views, self.action)
        if node is None:
            return None
        if self._planned[0] != self.graph.changes:
            far = self.graph.plan(self.goals)
            nearest = torch.where(far < 0, NO_WAY, far).min(1).values
            self._planned = self.graph.changes, torch.where(nearest == NO_WAY, -1, nearest)
        distances = self._planned[1]
        if distances[node] <= self.last_steps:  # -1 where no way is known
            return None
        return self.graph.next_action(node, distances)


def guide_to(graph: ImageGraph | str | Path, goal_views: Tensor, last_steps: int, extractor: str) -> Guide:
    """A guide by a map, or by one that was saved.

    Args:
        graph: the map, or its folder.
        goal_views: see `Guide`.
        last_steps: see `Guide`.
        extractor: of the navigator's features.

    Raises:
        NavigatorError: there is no such map, it is of another extractor, or it does not fit the features.
    """
    try:
        found = graph if isinstance(graph, ImageGraph) else load_graph(graph, extractor=extractor)
    except MapError as error:
        raise NavigatorError(str(error)) from None
    width = found.views.shape[-1]
    if len(found) and width != goal_views.shape[-1]:
        raise NavigatorError(f"the map has {width} features a view, the navigator {goal_views.shape[-1]}")
    return Guide(found, torch.as_tensor(goal_views), last_steps)
