"""A topological map: what was seen on a walk, merged where it looks the same, and the moves from one node to another.

Localisation, in a walk and later, stays with the node that was expected after the last action while it looks enough
like what is seen, and takes another one only if that looks clearly more alike (hysteresis). A single observation that
fits nowhere is passed over.

A place that is reached by a new edge and looks like a known one may be another (perceptual aliasing): see `Doubt`.
"""

from collections.abc import Collection, Iterator
from dataclasses import dataclass

from torch import Tensor

from dirl.agent.images import NavigatorError, check_turns
from dirl.agent.mapping.panoramas import UNDOES, UNKNOWN, VIEWS, Panoramas, turned
from dirl.perception.recognition.recogniser import Recogniser
from dirl.scenes.graph import AHEAD, BACK, RIGHT

KEEP, LIKELY = 0.6, 0.0
"""Above this correlation, or these log odds, the node that was expected is believed."""

MARGIN, ODDS_MARGIN = 0.1, 1.0
"""If no other looks more alike by as much, likewise."""


class MapError(NavigatorError):
    """A map that cannot be used as asked; the message says why in one line."""


class ImageGraph(Panoramas):
    """A map of N = 4 S nodes, empty at first.

    Args:
        threshold: above this score two observations are of the same node; if left out 0.9, of log odds the
            recogniser's own for a memory. That of others is too low: one wrong merge spoils the map.
        turns: right turns in a full circle.
        recogniser: by which observations are compared; correlation if left out.

    Raises:
        MapError: a correlation that cannot be.
        NavigatorError: turns that are no multiple of four.
    """

    def __init__(self, threshold: float | None = None, turns: int = 4, *, recogniser: Recogniser | None = None) -> None:
        super().__init__(turns, recogniser)
        odds, own = self.recogniser.calibrated, self.recogniser.thresholds
        if threshold is None:
            threshold = own.memory if odds and own is not None else 0.9
        if not odds and not -1 <= threshold <= 1:
            raise MapError(f"threshold={threshold:g}: expected a correlation, -1 to 1")
        check_turns(turns)
        self.threshold, self.keep = threshold, min(LIKELY if odds else KEEP, threshold)
        self.margin = ODDS_MARGIN if odds else MARGIN
        self.doubt: Doubt | None = None
        """While it is not known whether the walker is in a new place or in a known one that looks the same."""
        self._coasting = False

    def see(self, views: Tensor, action: int | None = None) -> int:
        """Add an observation to the map and return the node where the walker is now.

        Args:
            views: described, ahead, right, back and left, float32 ``[4, F]``.
            action: what the walker did since the last look; None if it stood still, or was carried.
        """
        if self.doubt is not None and action is not None and self._settle(self.doubt, views, action):
            assert self.at is not None
            return self.at
        before = self.at
        node = self.locate(views, action)
        twins = None if node is None else self._possible_twins(views, action)
        if node is None and self._coast(action):
            node = self._expected(action)
        elif node is None or twins is not None:
            before = None if self._coasting else before
            node = self.add_panorama(views)
            self.doubt = Doubt(twins, [_pairs(node, twin) for twin in twins]) if twins else None
        self.record(before, action, node)
        self.at = node
        return node

    def locate(self, views: Tensor, action: int | None = None, least: float | None = None) -> int | None:
        """Return the node that an observation is of, None if no node looks like it; `at` does not change.

        Args:
            views: described, ahead, right, back and left, float32 ``[4, F]``.
            action: what was done since the look at `at`; None if nothing.
            least: the score that a node must have which was not expected; the threshold if left out.
        """
        if not len(self):
            return None
        scores = self.scores(views)
        best = int(scores.argmax())
        expected = self._expected(action)
        if expected != UNKNOWN and self.fits(scores, expected):
            return expected
        return best if scores[best] > (self.threshold if least is None else least) else None

    def fits(self, scores: Tensor, node: int) -> bool:
        """Return True if an expected node is believed, by the `scores` of what is seen, float32 ``[N]``."""
        return bool(scores[node] > self.keep and scores.max() <= scores[node] + self.margin)

    def alike(self, views: Tensor) -> list[int]:
        """Return the nodes that an observation, float32 ``[4, F]``, could be of, the most alike first."""
        scores = self.scores(views)
        possible = (scores > self.threshold) & (scores >= scores.max() - self.margin)
        return [node for node in scores.argsort(descending=True).tolist() if possible[node]]

    def follow(self, views: Tensor, action: int | None = None) -> int | None:
        """Return the node where the walker is; None where no node looks like what is seen: it may be anywhere.

        No panoramas are added; a move that led elsewhere twice is corrected.
        """
        self._end_doubt()
        before, node = self.at, self.locate(views, action, self.keep)
        if node is not None:
            self._coasting = False
            self.record(before, action, node)
        elif self._coast(action):
            node = self._expected(action)
        self.at = node
        return node

    def lose(self) -> None:
        """Forget where the walker is: it is carried elsewhere, or begins a new walk."""
        self._end_doubt()
        self.at, self._coasting = None, False

    def frontier_action(self) -> int | None:
        """Return the first action on a shortest path to an action whose outcome is not known.

        None if everything that can be reached is known, or nothing was seen yet.
        """
        node = self.at
        if node is None:
            return None
        if self.doubt is not None and (testing := self._testing_action(self.doubt)) is not None:
            return testing
        tried = (AHEAD, BACK) if self.turns == VIEWS else (AHEAD, BACK, RIGHT)
        for here, began in self._reached(node):
            for action in tried:
                if self.moves[here][action] == UNKNOWN:
                    return action if began is None else began
        return None

    def _reached(self, start: int, closed: Collection[int] = ()) -> Iterator[tuple[int, int | None]]:
        """Yield the nodes that known moves lead to, the nearest first, each with the first action on the way there.

        That of the start is None; nodes that are ``closed`` are not passed.
        """
        first: dict[int, int | None] = {start: None}
        queue = [start]
        for here in queue:
            began = first[here]
            yield here, began
            for action, there in enumerate(self.moves[here]):
                if there != UNKNOWN and there not in first and there not in closed:
                    first[there] = action if began is None else began
                    queue.append(there)

    def _expected(self, action: int | None) -> int:
        """Return where the walker must be after an action by the map; `UNKNOWN` if that is not known."""
        if self.at is None or action is None:
            return UNKNOWN if self.at is None else self.at
        return self.moves[self.at][action]

    def _end_doubt(self) -> None:
        """Believe the best match of a walk that ended before it was told from its twin."""
        if self.doubt is not None:
            self.merge_panoramas(self.doubt.same[0])
            self.doubt = None

    def _coast(self, action: int | None) -> bool:
        """Return True if an observation that fits nowhere is ignored: the first after a move whose end is known."""
        known = action is not None and self._expected(action) != UNKNOWN
        self._coasting = known and not self._coasting
        return self._coasting

    def _possible_twins(self, views: Tensor, action: int | None) -> list[int] | None:
        """Return the nodes that look like what is seen, the most alike first, if the walker may be in a new place too.

        A blocked move leads to the same node, and turns to the same place: that is believed (None). Nodes that are
        known to be turned to from another one do not count.
        """
        before = self.at
        if before is None or action is None or self.moves[before][action] != UNKNOWN:
            return None
        alike = self.alike(views)
        if action in (AHEAD, BACK):
            return None if before in alike else alike
        if {node // VIEWS for node in alike} & self.place(before):
            return None
        return [node for node in alike if self.moves[node][UNDOES[action]] in (UNKNOWN, before)]

    def _testing_action(self, doubt: "Doubt") -> int | None:
        """Return the first action on a shortest path to a neighbour of the best candidate; None if it has none."""
        same = doubt.same[0]
        for here, began in self._reached(doubt.candidates[0], same):
            for action in (AHEAD, BACK):
                there = self.moves[here][action]
                if there not in (UNKNOWN, here) and there not in same:
                    return action if began is None else began
        return None

    def _settle(self, doubt: "Doubt", views: Tensor, action: int) -> bool:
        """Add a look of a walker in doubt, which most moves end; return False if it is to be added as usual."""
        scores = self.scores(views)
        after = [self.moves[node][action] for node in doubt.candidates]
        fitting = [i for i, node in enumerate(after) if node != UNKNOWN and self.fits(scores, node)]
        moved = [i for i in fitting if action in (AHEAD, BACK) and after[i] != doubt.candidates[i]]
        unknown = [i for i, node in enumerate(after) if node == UNKNOWN]
        if moved or not fitting:
            self.doubt = None
            if moved or unknown:
                best = max(moved, key=lambda i: float(scores[after[i]])) if moved else unknown[0]
                self.merge_panoramas(doubt.same[best])
            return False
        doubt.same = [doubt.same[i] for i in fitting]
        after = [after[i] for i in fitting]
        back = [new for new, old in doubt.same[0].items() if old == after[0]]
        here = back[0] if back else self.add_panorama(views)
        for same, node in zip(doubt.same, after, strict=True):
            same.update({} if back else _pairs(here, node))
        self.record(self.at, action, here)
        self.at, doubt.candidates = here, after
        return True


@dataclass
class Doubt:
    """A match that is not believed yet: the walker is in one of some known nodes, or in their twin.

    A panorama is made for it, and for each of these candidates it is tracked where the walker would be. If a move leads
    to where the candidate's neighbour is seen, that candidate and the new panorama are merged; if it leads to something
    else, they are not. Where the map knows too little to decide, the match is believed.
    """

    candidates: list[int]
    """The nodes where the walker may be now, the most alike first."""
    same: list[dict[int, int]]
    """For each, which nodes those of the panoramas made since would be."""


def _pairs(new: int, old: int) -> dict[int, int]:
    """Return the nodes of a panorama ``new``, each with the node of the panorama of ``old`` that it would be."""
    return {new + k: turned(old, k) for k in range(VIEWS)}
