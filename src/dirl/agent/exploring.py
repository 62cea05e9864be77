"""A navigator with a map: a walk that makes one, and the path to a photo by it."""

from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor

from dirl.agent.images import Images, NavigatorError
from dirl.agent.mapping import ImageGraph, MapError, PlaceMap, load_graph, save_graph
from dirl.agent.mapping.looks import VIEWS
from dirl.agent.mapping.places import ParticleMapper
from dirl.recognition.matching import normal_vectors
from dirl.scenes.graph import LEFT, RIGHT

NO_WAY = 2**30
"""More steps than any path has."""

QUARTERS = 4
"""So many quarter turns are compared before `TurnCheck` judges."""


class Explorer:
    """A walk through a place, by a robot or a person, that makes a map of it. Made by `dirl.Navigator.explore`.

    Args:
        encode: images of four views to what the map takes: their features, float32 ``[4, D]``, or descriptions.
        graph: the map, empty or of an earlier walk; or what makes one by what an agent's memory believes.
        extractor: what makes the features, written into saved maps.
        recogniser: what makes descriptions, likewise.
    """

    def __init__(
        self,
        encode: Callable[[Images], Tensor],
        graph: ImageGraph | ParticleMapper,
        extractor: str,
        recogniser: str = "none",
    ) -> None:
        self._encode, self.graph, self.extractor, self.recogniser = encode, graph, extractor, recogniser
        self._turns = TurnCheck(graph)

    def see(self, images: Images, action: int | None = None) -> int:
        """Add what is seen now to the map: the node where the walker is.

        Args:
            images: uint8 RGB ``[4, H, W, 3]``, ahead, right, back and left.
            action: what the walker did since the images before (0 ahead, 1 right, 2 left, 3 back), also if it was
                blocked; None if it did nothing.

        Raises:
            NavigatorError: images of another shape or type, an unknown action, or turns of another angle than
                the map's.
        """
        if action not in (None, 0, 1, 2, 3):
            raise NavigatorError(f"action={action!r}: expected 0 ahead, 1 right, 2 left, 3 back, or None")
        views = self._encode(images)
        self._turns.see(views, action)
        return self.graph.see(views, action)

    def next_action(self) -> int | None:
        """The action after which most is learned soonest; None if everything in reach is known, or nothing was seen.

        Before a walk ends in which hardly any quarter turns were compared (see `TurnCheck`), it turns around once: with
        wrong ``turns`` little seems to be unknown.
        """
        if not self._turns.begun:
            return None
        action = self.graph.frontier_action()
        return RIGHT if action is None and self._turns.compared < QUARTERS else action

    def save(self, folder: str | Path) -> Path:
        """Write the map into a folder, see `dirl.agent.mapping.save_graph`."""
        found = self.graph if isinstance(self.graph, ImageGraph) else self.graph.map()
        return save_graph(found, folder, extractor=self.extractor, recogniser=self.recogniser)


class TurnCheck:
    """Whether the walker turns by the angle that a map believes.

    After a quarter turn the view ahead is the one that was aside before, and so on around. With another number of turns
    in a full circle it is not, and the map would go wrong without a sign.

    Args:
        graph: the map: how many turns make a full circle, and how much two observations must be alike.
    """

    def __init__(self, graph: ImageGraph | ParticleMapper) -> None:
        self.graph = graph
        self.fitting = self.contrary = 0
        self._side: int | None = None
        self._seen: list[Tensor] = []

    @property
    def begun(self) -> bool:
        """Whether anything was seen."""
        return bool(self._seen)

    @property
    def compared(self) -> int:
        """The number of quarter turns that were compared."""
        return self.fitting + self.contrary

    def see(self, views: Tensor, action: int | None) -> None:
        """Compare an observation, float32 ``[4, D]``, with the one a quarter turn ago, if the action ends such a turn.

        Raises:
            NavigatorError: of `QUARTERS` quarter turns or more, most showed something else.
        """
        views, quarter = views.detach().float().cpu(), self.graph.turns // VIEWS
        turned = action in (RIGHT, LEFT)
        if not turned:
            self._seen = []
        elif action != self._side:
            self._seen = self._seen[-1:]
        self._side = action
        if turned and len(self._seen) >= quarter:
            fits = self._fits(self._seen[-quarter], views, 1 if action == RIGHT else -1)
            self.fitting, self.contrary = self.fitting + fits, self.contrary + (not fits)
        self._seen = [*self._seen[-quarter:], views]
        if self.compared >= QUARTERS and self.contrary > self.fitting:
            raise NavigatorError(
                f"turns={self.graph.turns}: after {self.contrary} of {self.compared} quarter turns the "
                "views are not those that were aside before; give the number of turns that make a full circle"
            )

    def _fits(self, before: Tensor, now: Tensor, side: int) -> bool:
        """Whether the view ahead was to the right (1) or to the left (-1) before, and so on around."""
        each = torch.stack([now.roll(side + k, 0).flatten() for k in range(VIEWS)])
        scores = normal_vectors(each) @ normal_vectors(before.flatten())
        return bool(scores[0] > self.graph.keep and scores.max() <= scores[0] + self.graph.margin)


class Guide:
    """The path to one goal by a topological map, step by step; errors of the map are corrected on the way.

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
        self.goals = (scores >= self.match - graph.margin / 2).nonzero().flatten().tolist()
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
        if distances[node] <= self.last_steps:  # -1 where no path is known
            return None
        return self.graph.next_action(node, distances)


def guide_to(graph: ImageGraph, goal_views: Tensor, last_steps: int) -> Guide:
    """A guide by a topological map.

    Args:
        graph: the map.
        goal_views: see `Guide`.
        last_steps: see `Guide`.

    Raises:
        NavigatorError: the map does not fit the features.
    """
    if isinstance(last_steps, bool) or not isinstance(last_steps, int) or last_steps < 0:
        raise NavigatorError(f"last_steps={last_steps!r}: expected 0 or a positive integer")
    width = graph.views.shape[-1]
    if len(graph) and width != goal_views.shape[-1]:
        raise NavigatorError(f"the map has {width} features a view, the navigator {goal_views.shape[-1]}")
    return Guide(graph, torch.as_tensor(goal_views), last_steps)


def map_of(graph: object, extractor: str, recogniser: str) -> ImageGraph | PlaceMap:
    """A map, or the one that was saved in a folder.

    Args:
        graph: the map, or its folder.
        extractor: of the navigator's features.
        recogniser: of the navigator, see `dirl.recognition.build.recogniser_name`.

    Raises:
        NavigatorError: there is no such map, or it was made with another extractor or recogniser.
    """
    if isinstance(graph, ImageGraph | PlaceMap):
        return graph
    if not isinstance(graph, str | Path):
        raise NavigatorError(f"graph={graph!r}: expected a map, or the folder of a saved one")
    try:
        return load_graph(graph, extractor=extractor, recogniser=recogniser)
    except MapError as error:
        raise NavigatorError(str(error)) from None
