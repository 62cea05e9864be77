"""An image graph: what was seen on a walk, merged where it looks the same, and the moves from one look to another.

A *station* is a look around: the views ahead, right, back and left. Seen from there a quarter further to the right, the
same four views are in another order, so that each station is four *nodes*: node ``4 * station + k`` is the station k
quarters to the right. Localisation, in a walk and later, stays with the node that was expected after the last action
while it looks enough like what is seen, and takes another one only if that looks clearly more alike (hysteresis).
"""

from collections import deque
from collections.abc import Sequence

import torch
from torch import Tensor

from dirl.scenes.graph import ACTIONS, AHEAD, BACK, LEFT, RIGHT, shortest_distances
from dirl.scenes.matching import normal_vectors

UNKNOWN, VIEWS = -1, 4

KEEP = 0.6

UNDOES = {AHEAD: BACK, BACK: AHEAD, RIGHT: LEFT, LEFT: RIGHT}


class MapError(ValueError):
    """An image graph that cannot be used as asked; the message says why in one line."""


class ImageGraph:
    """A map of N = 4 S nodes, empty at first.

    Args:
        threshold: above this correlation of four views two looks around are of the same node.
        keep: above this one the expected node is believed, unless another looks more alike by ``margin``; `KEEP` or the
            threshold, whichever is lower, if left out.
        margin: see ``keep``.
        turns: right turns in a full circle.
        merge: whether nodes are recognised; without it each step makes a new station, and the map is a list.

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
    ) -> None:
        keep = min(KEEP, threshold) if keep is None else keep
        if not -1 <= keep <= threshold <= 1 or not 0 <= margin <= 2:
            raise MapError(
                f"keep={keep:g}, threshold={threshold:g}, margin={margin:g}: expected -1 <= keep <= threshold <= 1 and "
                "a margin of 0 to 2"
            )
        if turns < 4 or turns % 4:
            raise MapError(f"turns={turns}: must be a multiple of four")
        self.threshold, self.keep, self.margin, self.turns, self.merge = threshold, keep, margin, turns, merge
        self.moves: list[list[int]] = []
        """Where each action leads from each node: `UNKNOWN`, the node itself where it is blocked, or another."""
        self.observed: list[list[bool]] = []
        """Whether that was seen, or only inferred from the opposite move."""
        self.at: int | None = None
        """The node where the walker is; None before the first look and after `lose`."""
        self._views: list[Tensor] = []
        self._normal: dict[str, Tensor] = {}

    def __len__(self) -> int:
        """The number of nodes."""
        return len(self.moves)

    @property
    def views(self) -> Tensor:
        """The features of the four views of each station, float32 ``[S, 4, D]``."""
        return torch.stack(self._views) if self._views else torch.empty(0, VIEWS, 0)

    def see(self, views: Tensor, action: int | None = None) -> int:
        """Add a look around to the map: the node where the walker is now.

        Args:
            views: features ahead, right, back and left, float32 ``[4, D]``.
            action: what the walker did since the last look; None if it stood still, or was carried.
        """
        before = self.at
        node = self.locate(views, action) if self.merge or action is None else None
        if node is None:
            node = self._add_station(views)
        self._record(before, action, node)
        self.at = node
        return node

    def locate(self, views: Tensor, action: int | None = None) -> int | None:
        """The node that a look around is of, None if no node looks like it; `at` is what it was before.

        Args:
            views: features ahead, right, back and left, float32 ``[4, D]``.
            action: what was done since the look at `at`; None if nothing.
        """
        if not self._views:
            return None
        scores = self.scores(views)
        best = int(scores.argmax())
        expected = UNKNOWN
        if self.at is not None:
            expected = self.at if action is None else self.moves[self.at][action]
        if expected != UNKNOWN and scores[expected] > self.keep and scores[best] < scores[expected] + self.margin:
            return expected
        return best if scores[best] > self.threshold else None

    def follow(self, views: Tensor, action: int | None = None) -> int | None:
        """Keep track of a walker without adding stations; moves that led elsewhere than the map says are corrected.

        Returns:
            The node where it is; None where nothing looks like what is seen, and then it may be anywhere.
        """
        before, node = self.at, self.locate(views, action)
        if node is not None:
            self._record(before, action, node)
        self.at = node
        return node

    def lose(self) -> None:
        """Forget where the walker is: it is carried elsewhere, or begins a new walk."""
        self.at = None

    def scores(self, views: Tensor) -> Tensor:
        """The correlation of looks around with every node, float32 ``[..., N]``.

        Args:
            views: features of four views, float32 ``[..., 4, D]``; or of one photo, ``[..., 1, D]``, which is compared
                with the view ahead of each node.
        """
        views = views.float().cpu()
        if views.shape[-2] == 1:
            return normal_vectors(views.squeeze(-2)) @ self._vectors("one").flatten(0, 1).T
        now = normal_vectors(views.flatten(-2)).view_as(views)
        pairs = now @ self._vectors("four").flatten(0, 1).T  # of each view now with each view of each station
        pairs = pairs.unflatten(-1, (-1, VIEWS))
        order = torch.arange(VIEWS)
        turned = [pairs[..., order, :, (order + k) % VIEWS].sum(0) for k in range(VIEWS)]
        return torch.stack(turned, -1).flatten(-2)

    def plan(self, goals: Sequence[int]) -> Tensor:
        """The fewest actions from each node to each goal, int32 ``[N, G]``, -1 where no way is known."""
        return torch.from_numpy(shortest_distances(torch.tensor(self.moves).numpy(), torch.tensor(goals).numpy()))

    def next_action(self, node: int, distances: Tensor) -> int | None:
        """The first action of a shortest way.

        Args:
            node: where the walker is.
            distances: to one goal, of every node, int32 ``[N]``; a column of `plan`.

        Returns:
            None at the goal, and where no way is known.
        """
        for action, there in enumerate(self.moves[node]):
            if there >= 0 and 0 <= distances[there] < distances[node]:
                return action
        return None

    def frontier_action(self, node: int) -> int | None:
        """What to do next to learn more: the first action on a shortest way to one whose outcome is not known.

        Returns:
            None if everything that can be reached is known.
        """
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

    def _vectors(self, kind: str) -> Tensor:
        """The views of each station as normal vectors, each by itself (``one``) or all four together (``four``)."""
        if kind not in self._normal:
            views = self.views
            together = normal_vectors(views.flatten(1)).view_as(views) if kind == "four" else normal_vectors(views)
            self._normal[kind] = together
        return self._normal[kind]

    def _add_station(self, views: Tensor) -> int:
        node = len(self.moves)
        self._views.append(views.detach().float().cpu().clone())
        self._normal.clear()
        for k in range(VIEWS):
            moves = [UNKNOWN] * len(ACTIONS)
            if self.turns == VIEWS:
                moves[RIGHT], moves[LEFT] = node + (k + 1) % VIEWS, node + (k - 1) % VIEWS
            self.moves.append(moves)
            self.observed.append([self.turns == VIEWS and action in (RIGHT, LEFT) for action in range(len(ACTIONS))])
        return node

    def _record(self, before: int | None, action: int | None, node: int) -> None:
        """Remember what an action did, and infer what follows: moves can be undone, and walked backwards."""
        if before is None or action is None or (action in (RIGHT, LEFT) and before == node):
            return
        self._link(before, action, node, observed=True)
        if node != before:
            self._link(node, UNDOES[action], before, observed=False)
        if action in (AHEAD, BACK):  # facing the other way, the same move has the other name
            self._link(_half(before), UNDOES[action], _half(node), observed=False)
            if node != before:
                self._link(_half(node), action, _half(before), observed=False)

    def _link(self, start: int, action: int, end: int, *, observed: bool) -> None:
        if observed or not self.observed[start][action]:
            self.moves[start][action] = end
            self.observed[start][action] |= observed


def _half(node: int) -> int:
    """The node of the same station that looks the other way."""
    return node - node % VIEWS + (node + 2) % VIEWS
