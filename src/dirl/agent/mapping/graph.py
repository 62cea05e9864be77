"""A topological map: what was seen on a walk, merged where it looks the same, and the moves from one node to another.

A *panorama* is one observation: the views ahead, right, back and left. Seen from there a quarter further to the right,
the same four views are in another order, so that each panorama is four *nodes*: node ``4 * panorama + k`` is the
panorama k quarters to the right. Localisation, in a walk and later, stays with the node that was expected after the
last action while it looks enough like what is seen, and takes another one only if that looks clearly more alike
(hysteresis). A single observation that fits nowhere is passed over.

A place that is reached by a new edge and looks like a known one may be another (perceptual aliasing). The next move
decides: see `dirl.agent.mapping.doubt`.
"""

from collections import deque
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from dirl.agent.mapping.doubt import Doubt, settle
from dirl.agent.mapping.looks import UNKNOWN, VIEWS, Looks, turned
from dirl.scenes.graph import ACTIONS, AHEAD, BACK, LEFT, RIGHT, shortest_distances

KEEP = 0.6

UNDOES = {AHEAD: BACK, BACK: AHEAD, RIGHT: LEFT, LEFT: RIGHT}


class MapError(ValueError):
    """A topological map that cannot be used as asked; the message says why in one line."""


class ImageGraph:
    """A map of N = 4 S nodes, empty at first.

    Args:
        threshold: above this correlation of four views two observations are of the same node.
        keep: above this one the expected node is believed, unless another looks more alike by ``margin``; `KEEP` or the
            threshold, whichever is lower, if left out.
        margin: see ``keep``.
        turns: right turns in a full circle.
        merge: whether nodes are recognised; without it each step makes a new panorama, and the map is a list.
        verify: whether a match is believed only after a move to a neighbour that matches too.

    Raises:
        MapError: a threshold out of bounds, or turns that are no multiple of four.
    """

    def __init__(
        self,
        threshold: float = 0.9,
        keep: float | None = None,
        margin: float = 0.1,
        turns: int = 4,
        *,
        merge: bool = True,
        verify: bool = True,
    ) -> None:
        keep = min(KEEP, threshold) if keep is None else keep
        if not -1 <= keep <= threshold <= 1 or not 0 <= margin <= 2:
            raise MapError(
                f"keep={keep:g}, threshold={threshold:g}, margin={margin:g}: expected -1 <= keep <= threshold <= 1 and "
                "a margin of 0 to 2"
            )
        if turns < 4 or turns % 4:
            raise MapError(f"turns={turns}: must be a multiple of four")
        self.threshold, self.keep, self.margin, self.turns = threshold, keep, margin, turns
        self.merge, self.verify = merge, verify
        self.moves: list[list[int]] = []
        """Where each action leads from each node: `UNKNOWN`, the node itself where it is blocked, or another."""
        self.observed: list[list[bool]] = []
        """Whether that was seen, or only inferred from the opposite move."""
        self.at: int | None = None
        """The node where the walker is; None before the first look and after `lose`."""
        self.doubt: Doubt | None = None
        """While it is not known whether the walker is in a new place or in a known one that looks the same."""
        self.changes = 0
        """Grows whenever the map changes."""
        self.looks = Looks()
        self._denied: dict[tuple[int, int], int] = {}
        self._coasting = False

    def __len__(self) -> int:
        """The number of nodes."""
        return len(self.moves)

    @property
    def views(self) -> Tensor:
        """The features of the four views of each panorama, float32 ``[S, 4, D]``."""
        return self.looks.views

    def see(self, views: Tensor, action: int | None = None) -> int:
        """Add an observation to the map: the node where the walker is now.

        Args:
            views: features ahead, right, back and left, float32 ``[4, D]``.
            action: what the walker did since the last look; None if it stood still, or was carried.
        """
        if self.doubt is not None and action is not None and settle(self, views, action):
            assert self.at is not None
            return self.at
        before = self.at
        node = self.locate(views, action) if self.merge or action is None else None
        twins = None if node is None else self._possible_twins(views, action)
        if node is None and self._coast(action):
            node = self._expected(action)
        elif node is None or twins is not None:
            before = None if self._coasting else before
            node = self.add_station(views)
            self.doubt = Doubt(node, twins) if twins else None
        self.record(before, action, node)
        self.at = node
        return node

    def locate(self, views: Tensor, action: int | None = None, least: float | None = None) -> int | None:
        """The node that an observation is of, None if no node looks like it; `at` is what it was before.

        Args:
            views: features ahead, right, back and left, float32 ``[4, D]``.
            action: what was done since the look at `at`; None if nothing.
            least: the correlation that a node must have which was not expected; the threshold if left out.
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
        """Whether a node that was expected is believed, by the `scores` of what is seen, float32 ``[N]``."""
        return bool(scores[node] > self.keep and scores.max() <= scores[node] + self.margin)

    def alike(self, views: Tensor) -> list[int]:
        """The nodes that an observation could be of, float32 ``[4, D]``; the most alike first."""
        scores = self.scores(views)
        possible = (scores > self.threshold) & (scores >= scores.max() - self.margin)
        return [node for node in scores.argsort(descending=True).tolist() if possible[node]]

    def follow(self, views: Tensor, action: int | None = None) -> int | None:
        """Keep track of a walker without adding panoramas; a move that led elsewhere twice is corrected.

        Returns:
            The node where it is; None where nothing looks like what is seen, and then it may be anywhere.
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

    def scores(self, views: Tensor) -> Tensor:
        """The correlation of observations with every node, float32 ``[..., N]``.

        Args:
            views: features of four views, float32 ``[..., 4, D]``; or of one photo, ``[..., 1, D]``, which is compared
                with the view ahead of each node.
        """
        return self.looks.scores(views)

    def plan(self, goals: Sequence[int]) -> Tensor:
        """The fewest actions from each node to each goal, int32 ``[N, G]``, -1 where no path is known."""
        return torch.from_numpy(shortest_distances(torch.tensor(self.moves).numpy(), torch.tensor(goals).numpy()))

    def next_action(self, node: int, distances: Tensor) -> int | None:
        """The first action of a shortest path.

        Args:
            node: where the walker is.
            distances: to one goal, of every node, int32 ``[N]``; a column of `plan`.

        Returns:
            None at the goal, and where no path is known.
        """
        for action, there in enumerate(self.moves[node]):
            if there >= 0 and 0 <= distances[there] < distances[node]:
                return action
        return None

    def frontier_action(self) -> int | None:
        """What to do next to learn more: the first action on a shortest path to one whose outcome is not known.

        Returns:
            None if everything that can be reached is known, or nothing was seen yet.
        """
        node = self.at
        if node is None:
            return None
        if self.doubt is not None and (testing := self.doubt.testing_action(self)) is not None:
            return testing
        tried = (AHEAD, BACK) if self.turns == VIEWS else (AHEAD, BACK, RIGHT)
        first: dict[int, int | None] = {node: None}
        queue = deque([node])
        while queue:
            here = queue.popleft()
            for action in tried:
                if self.moves[here][action] == UNKNOWN:
                    began = first[here]
                    return action if began is None else began
            for action, there in enumerate(self.moves[here]):
                if there >= 0 and there not in first:
                    first[there] = action if first[here] is None else first[here]
                    queue.append(there)
        return None

    def add_station(self, views: Tensor) -> int:
        """A new panorama with these views, float32 ``[4, D]``; the node that faces ahead."""
        node = len(self.moves)
        self.looks.add(views)
        for k in range(VIEWS):
            moves = [UNKNOWN] * len(ACTIONS)
            if self.turns == VIEWS:
                moves[RIGHT], moves[LEFT] = node + (k + 1) % VIEWS, node + (k - 1) % VIEWS
            self.moves.append(moves)
            self.observed.append([self.turns == VIEWS and action in (RIGHT, LEFT) for action in range(len(ACTIONS))])
        self.changes += 1
        return node

    def merge_stations(self, same: Mapping[int, int]) -> None:
        """Make the last panoramas the same as earlier ones.

        Args:
            same: to which node each node of the last panoramas is equal.
        """
        first = min(same)
        for node, moves in enumerate(self.moves):
            if node >= first:
                for action, there in enumerate(moves):
                    if there != UNKNOWN:
                        self.link(same[node], action, same.get(there, there), observed=self.observed[node][action])
            else:
                self.moves[node] = [same.get(there, there) for there in moves]
        self._denied = {key: there for key, there in self._denied.items() if max(key[0], there) < first}
        del self.moves[first:], self.observed[first:]
        self.looks.shorten(first // VIEWS)
        self.at = None if self.at is None else same.get(self.at, self.at)
        self.changes += 1

    def _expected(self, action: int | None) -> int:
        """Where the walker must be after an action by the map; `UNKNOWN` if that is not known."""
        if self.at is None or action is None:
            return UNKNOWN if self.at is None else self.at
        return self.moves[self.at][action]

    def _end_doubt(self) -> None:
        """Believe the best match of a walk that ended before it was told from its twin."""
        if self.doubt is not None:
            self.merge_stations(self.doubt.same[0])
            self.doubt = None

    def _coast(self, action: int | None) -> bool:
        """Whether an observation that fits nowhere is passed over: the first after a move whose end is known."""
        known = self.merge and action is not None and self._expected(action) != UNKNOWN
        self._coasting = known and not self._coasting
        return self._coasting

    def _possible_twins(self, views: Tensor, action: int | None) -> list[int] | None:
        """The nodes that look like what is seen, the most alike first, if the walker may as well be in a new place.

        A blocked move leads to the same node, and turns to the same place: that is believed (None). Nodes that are
        known to be turned to from another one are not meant.
        """
        before = self.at
        if not self.verify or before is None or action is None or self.moves[before][action] != UNKNOWN:
            return None
        alike = self.alike(views)
        if action in (AHEAD, BACK):
            return None if before in alike else alike
        if {node // VIEWS for node in alike} & self._place(before):
            return None
        return [node for node in alike if self.moves[node][UNDOES[action]] in (UNKNOWN, before)]

    def _place(self, node: int) -> set[int]:
        """The panoramas that are known to be at the place of a node, because turns lead to them."""
        found, new = set[int](), {node // VIEWS}
        while new:
            found |= new
            nodes = [VIEWS * station + k for station in new for k in range(VIEWS)]
            new = {self.moves[one][turn] // VIEWS for one in nodes for turn in (RIGHT, LEFT)} - found - {UNKNOWN}
        return found

    def record(self, before: int | None, action: int | None, node: int) -> None:
        """Remember what an action did, and infer what follows: moves can be undone, and walked backwards."""
        if before is None or action is None or (action in (RIGHT, LEFT) and before == node):
            return
        self.link(before, action, node, observed=True)
        if self.moves[before][action] != node:  # not believed yet
            return
        if node != before:
            self.link(node, UNDOES[action], before, observed=False)
        if action in (AHEAD, BACK):  # facing the other way, the same move has the other name
            self.link(turned(before, 2), UNDOES[action], turned(node, 2), observed=False)
            if node != before:
                self.link(turned(node, 2), action, turned(before, 2), observed=False)
        else:
            self._infer_turns(*((before, node) if action == RIGHT else (node, before)))

    def _infer_turns(self, left: int, right: int) -> None:
        """What follows of a known turn to the right: that from the other headings, and the last one of a quarter."""
        for k in range(VIEWS):
            self.link(turned(left, k), RIGHT, turned(right, k), observed=False)
            self.link(turned(right, k), LEFT, turned(left, k), observed=False)
        first = right
        for _ in range(self.turns // VIEWS - 1):
            if first == UNKNOWN:
                return
            first = self.moves[first][LEFT]
        if first != UNKNOWN:
            for k in range(VIEWS):
                self.link(turned(right, k), RIGHT, turned(first, k + 1), observed=False)
                self.link(turned(first, k + 1), LEFT, turned(right, k), observed=False)

    def link(self, start: int, action: int, end: int, *, observed: bool) -> None:
        """Remember where an action leads; what was seen is only changed by what is seen twice."""
        if self.moves[start][action] == end or not self.observed[start][action]:
            self._denied.pop((start, action), None)
        elif not observed or self._denied.get((start, action)) != end:
            if observed:
                self._denied[start, action] = end
            return
        self.changes += self.moves[start][action] != end
        self.moves[start][action] = end
        self.observed[start][action] |= observed
