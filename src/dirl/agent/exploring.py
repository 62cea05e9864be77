"""A navigator with a map: a walk that makes one, and the path to a photo by it."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from dirl.agent.cameras import compare
from dirl.agent.images import Images, NavigatorError, check_turns
from dirl.agent.mapping import ImageGraph, PlaceMap, load_graph, save_graph
from dirl.agent.mapping.panoramas import VIEWS
from dirl.agent.mapping.places import ParticleMapper
from dirl.models import LocalisingMemory
from dirl.perception.recognition.recogniser import NCC, Recogniser, normal_vectors, recogniser_name
from dirl.scenes.graph import LEFT, RIGHT

QUARTERS = 4
"""Number of quarter turns that `TurnCheck` compares before it judges."""

ANY, NEARLY = -1.0, 0.05
"""Least correlation after a quarter turn, and how much better any other turn may fit, where views change on the way."""

OTHER_MEMORY = "graph: this map is for episodic_memory=localising; load the navigator with it"


class Explorer:
    """A walk through a place, by a robot or a person, that makes a map of it. Made by `dirl.Navigator.explore`.

    Args:
        encode: images of V views to what the map takes: their descriptions, float32 ``[V, F]``.
        graph: the map, empty or of an earlier walk; or what makes one by what an agent's memory believes.
        extractor: what makes the features, written into saved maps.
        recogniser: what makes the descriptions, likewise.
    """

    def __init__(
        self,
        encode: Callable[[Images], Tensor],
        graph: ImageGraph | ParticleMapper,
        extractor: str,
        recogniser: Recogniser | None = None,
    ) -> None:
        self._encode, self.graph, self.extractor, self.recogniser = encode, graph, extractor, recogniser
        self._turns = TurnCheck(graph)

    def see(self, images: Images, action: int | None = None) -> int:
        """Add what is seen now to the map and return the node where the walker is.

        Args:
            images: uint8 RGB ``[4, H, W, 3]``, ahead, right, back and left; for a `PlaceMap` also those of a
                panorama, one for each of the ``turns``, always as many.
            action: what the walker did since the images before (0 ahead, 1 right, 2 left, 3 back), also if it was
                blocked; None if it did nothing.

        Raises:
            NavigatorError: images of another shape or type, an unknown action, or turns of another angle than
                the map's.
        """
        if action not in (None, 0, 1, 2, 3):
            raise NavigatorError(f"action={action!r}: expected 0 ahead, 1 right, 2 left, 3 back, or None")
        views = self._encode(images)
        self._turns.see(views[:: len(views) // VIEWS], action)
        return self.graph.see(views, action)

    def next_action(self) -> int | None:
        """Return the action that leads soonest to something unknown; None without any in reach, or before a look.

        Before a walk ends in which hardly any quarter turns were compared (see `TurnCheck`), it turns around once: with
        wrong ``turns`` little seems to be unknown.
        """
        if not self._turns.seen:
            return None
        action = self.graph.frontier_action()
        return RIGHT if action is None and len(self._turns.fits) < QUARTERS else action

    def save(self, folder: str | Path) -> Path:
        """Write the map into a folder, see `dirl.agent.mapping.save_graph`."""
        place_map = self.graph if isinstance(self.graph, ImageGraph) else self.graph.map()
        return save_graph(place_map, folder, extractor=self.extractor, recogniser=self.recogniser)


class TurnCheck:
    """Whether the walker turns by the angle that a map believes.

    After a quarter turn the view ahead is the one that was aside before, and so on around. With another number of turns
    in a full circle it is not, and the map would go wrong without a sign.
    """

    def __init__(self, graph: ImageGraph | ParticleMapper) -> None:
        self.turns = graph.turns
        self.keep, self.margin = ANY, NEARLY
        if isinstance(graph, ImageGraph) and isinstance(graph.recogniser, NCC):
            self.keep, self.margin = graph.keep, graph.margin
        self.fits: list[bool] = []
        """For each quarter turn, True if the views are those that were aside before."""
        self.seen: list[Tensor] = []
        """The observations since the last move."""
        self._side: int | None = None

    def see(self, views: Tensor, action: int | None) -> None:
        """Compare an observation, float32 ``[4, F]``, with the one a quarter turn ago, if the action ends such a turn.

        Raises:
            NavigatorError: of `QUARTERS` quarter turns or more, most showed something else.
        """
        views, quarter = views.detach().float().cpu(), self.turns // VIEWS
        turned = action in (RIGHT, LEFT)
        if not turned:
            self.seen = []
        elif action != self._side:
            self.seen = self.seen[-1:]
        self._side = action
        if turned and len(self.seen) >= quarter:
            side = 1 if action == RIGHT else -1  # where what is ahead now was before
            turned_back = torch.stack([views.roll(side + k, 0).flatten() for k in range(VIEWS)])
            scores = normal_vectors(turned_back) @ normal_vectors(self.seen[-quarter].flatten())
            self.fits.append(bool(scores[0] > self.keep and scores.max() <= scores[0] + self.margin))
        self.seen = [*self.seen[-quarter:], views]
        contrary = self.fits.count(False)
        if len(self.fits) >= QUARTERS and contrary > len(self.fits) / 2:
            raise NavigatorError(
                f"turns={self.turns}: after {contrary} of {len(self.fits)} quarter turns the "
                "views are not those that were aside before; give the number of turns that make a full circle"
            )


def map_to_walk_on(
    known: ImageGraph | PlaceMap | None, turns: int | None, memory: object, recogniser: Recogniser, threshold: float
) -> ImageGraph | ParticleMapper:
    """Return the map of a walk, a new one or one that is known; see `dirl.Navigator.explore`."""
    if turns is not None:
        check_turns(turns)
    if known is not None and turns not in (None, known.turns):
        raise NavigatorError(f"turns={turns}: this map was made with turns={known.turns}")
    if known is None and turns is None:
        raise NavigatorError("explore: say how many right turns make a full circle: turns=4, 8 or 12")
    if isinstance(known, ImageGraph):
        return known
    if isinstance(memory, LocalisingMemory):
        return ParticleMapper(memory, partial(compare, recogniser), known=known, turns=turns or VIEWS)
    if known is not None:
        raise NavigatorError(OTHER_MEMORY)
    return ImageGraph(None if recogniser.calibrated else threshold, turns=turns or VIEWS, recogniser=recogniser)


def map_of(graph: object, extractor: str, recogniser: Recogniser, memory: object, turns: int) -> ImageGraph | PlaceMap:
    """Return the map, or load it from its folder, for a navigator with this extractor, recogniser, memory and turns.

    Raises:
        NavigatorError: there is no such map, or it is for another navigator.
    """
    if not isinstance(graph, ImageGraph | PlaceMap):
        if not isinstance(graph, str | Path):
            raise NavigatorError(f"graph={graph!r}: expected a map, or the folder of a saved one")
        graph = load_graph(graph, extractor=extractor, recogniser=recogniser)
    elif isinstance(graph, ImageGraph):
        own, name = recogniser_name(graph.recogniser), recogniser_name(recogniser)
        if own != name:
            raise NavigatorError(f"graph: was made with another recogniser: '{own}', not '{name}'")
    if isinstance(graph, PlaceMap) and not isinstance(memory, LocalisingMemory):
        raise NavigatorError(OTHER_MEMORY)
    if isinstance(graph, PlaceMap) and graph.turns != turns:
        raise NavigatorError(f"graph: was made with turns={graph.turns}, this navigator has {turns}")
    return graph
