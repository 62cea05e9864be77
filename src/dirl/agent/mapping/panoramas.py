"""What was seen at the panoramas of a map, and the moves that lead from one to another."""

import copy
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor, nn

from dirl.perception.recognition.recogniser import NCC, Recogniser
from dirl.scenes.graph import ACTIONS, AHEAD, BACK, LEFT, RIGHT, shortest_distances

UNKNOWN, VIEWS = -1, 4

UNDOES = {AHEAD: BACK, BACK: AHEAD, RIGHT: LEFT, LEFT: RIGHT}


def turned(node: int, quarters: int) -> int:
    """Return the node of the same panorama some quarters further to the right."""
    return node - node % VIEWS + (node + quarters) % VIEWS


class Panoramas:
    """S panoramas, N = 4 S nodes, none at first.

    A *panorama* is one observation: the views ahead, right, back and left. Seen from there a quarter further to the
    right, the same four views are in another order, so that each panorama is four *nodes*: node ``4 * panorama + k`` is
    the panorama k quarters to the right. ``turns`` is the number of right turns in a full circle.
    """

    def __init__(self, turns: int, recogniser: Recogniser | None = None) -> None:
        self.turns, self.recogniser = turns, recogniser or NCC()
        if isinstance(recogniser, nn.Module) and any(
            weights.device.type != "cpu" for weights in recogniser.state_dict().values()
        ):
            self.recogniser = copy.deepcopy(recogniser).cpu()  # what a map keeps is on the CPU, wherever the policy is
        self.moves: list[list[int]] = []
        """Where each action leads from each node: `UNKNOWN`, the node itself where it is blocked, or another."""
        self.observed: list[list[bool]] = []
        """Whether that was seen, or only inferred from the opposite move."""
        self.changes = 0
        """Grows whenever the map changes."""
        self.at: int | None = None
        """The node where the walker is; None before the first look, and where it may be anywhere."""
        self._denied: dict[tuple[int, int], int] = {}
        self._views: list[Tensor] = []

    def __len__(self) -> int:
        """Return the number of nodes."""
        return len(self.moves)

    @property
    def views(self) -> Tensor:
        """The described views of each panorama, float32 ``[S, 4, F]``."""
        return torch.stack(self._views) if self._views else torch.empty(0, VIEWS, 0)

    @torch.no_grad()
    def scores(self, views: Tensor) -> Tensor:
        """Return the recogniser's scores of observations with every node, float32 ``[..., N]``.

        Args:
            views: described, float32 ``[..., 4, F]``; or of one photo, ``[..., 1, F]``, which is compared with the view
                ahead of each node.
        """
        views = views.detach().float().cpu()
        if views.ndim > 2:  # one by one: the pairs of many looks with many nodes take much space
            return torch.stack([self.scores(look) for look in views])
        if views.shape[-2] == 1:
            each = torch.stack([self.views.roll(-k, -2) for k in range(VIEWS)], 1).flatten(0, 1)
            return self.recogniser.scores(each, views[None]).flatten()
        facing = torch.stack([views.roll(k, 0) for k in range(VIEWS)])
        return self.recogniser.scores(self.views, facing).flatten()

    def plan(self, goals: Sequence[int]) -> Tensor:
        """Return the fewest actions from each node to each goal, int32 ``[N, G]``, -1 where no path is known."""
        return torch.from_numpy(shortest_distances(torch.tensor(self.moves).numpy(), torch.tensor(goals).numpy()))

    def next_action(self, node: int, distances: Tensor) -> int | None:
        """Return the first action of a shortest path from a node; None at the goal, and where no path is known.

        The distances are a column of `plan`, int32 ``[N]``.
        """
        for action, there in enumerate(self.moves[node]):
            if there >= 0 and 0 <= distances[there] < distances[node]:
                return action
        return None

    def add_panorama(self, views: Tensor) -> int:
        """Add a panorama with these views, float32 ``[4, D]``; return its node that faces ahead."""
        node = len(self.moves)
        self._views.append(views.detach().float().cpu().clone())
        for k in range(VIEWS):
            moves = [UNKNOWN] * len(ACTIONS)
            if self.turns == VIEWS:
                moves[RIGHT], moves[LEFT] = node + (k + 1) % VIEWS, node + (k - 1) % VIEWS
            self.moves.append(moves)
            self.observed.append([self.turns == VIEWS and action in (RIGHT, LEFT) for action in range(len(ACTIONS))])
        self.changes += 1
        return node

    def merge_panoramas(self, same: Mapping[int, int]) -> None:
        """Make the last panoramas the same as earlier ones, by the node to which each of their nodes is equal.

        The walker is where it was.
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
        del self._views[first // VIEWS :]
        self.at = None if self.at is None else same.get(self.at, self.at)
        self.changes += 1

    def place(self, start: int) -> set[int]:
        """Return the panoramas that are known to be at the place of a node, because turns lead to them."""
        known, new = set[int](), {start // VIEWS}
        while new:
            known |= new
            nodes = [VIEWS * panorama + k for panorama in new for k in range(VIEWS)]
            new = {self.moves[node][turn] // VIEWS for node in nodes for turn in (RIGHT, LEFT)} - known - {UNKNOWN}
        return known

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
        """Infer from a known turn to the right those from the other headings, and the last one of a quarter."""
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
