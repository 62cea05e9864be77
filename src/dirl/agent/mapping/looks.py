"""What was seen at the panoramas of a map, and how much an observation is like them."""

import torch
from torch import Tensor

from dirl.recognition.matching import normal_vectors

UNKNOWN, VIEWS = -1, 4


def turned(node: int, quarters: int) -> int:
    """The node of the same panorama some quarters further to the right."""
    return node - node % VIEWS + (node + quarters) % VIEWS


class Looks:
    """The features of the four views of each of S panoramas; none at first."""

    def __init__(self) -> None:
        self._views: list[Tensor] = []
        self._normal: dict[str, tuple[Tensor, int]] = {}

    @property
    def views(self) -> Tensor:
        """Float32 ``[S, 4, D]``."""
        return torch.stack(self._views) if self._views else torch.empty(0, VIEWS, 0)

    def add(self, views: Tensor) -> None:
        """Add a panorama, float ``[4, D]``."""
        self._views.append(views.detach().float().cpu().clone())

    def shorten(self, stations: int) -> None:
        """Leave so many, the oldest."""
        del self._views[stations:]
        self._normal = {kind: (rows, min(done, stations)) for kind, (rows, done) in self._normal.items()}

    def scores(self, views: Tensor) -> Tensor:
        """See `dirl.agent.mapping.ImageGraph.scores`."""
        views = views.detach().float().cpu()
        if views.shape[-2] == 1:
            return normal_vectors(views.squeeze(-2)) @ self._vectors("one").flatten(0, 1).T
        now = normal_vectors(views.flatten(-2)).view_as(views)
        each = torch.stack([now.roll(k, -2).flatten(-2) for k in range(VIEWS)], -2)
        return (each @ self._vectors("four").flatten(1).T).transpose(-1, -2).flatten(-2)

    def _vectors(self, kind: str) -> Tensor:
        """The views of each panorama as normal vectors, each by itself (``one``) or all four together (``four``)."""
        rows, done = self._normal.get(kind, (torch.empty(0), 0))
        if done < len(self._views):
            new = torch.stack(self._views[done:])
            new = normal_vectors(new.flatten(1)).view_as(new) if kind == "four" else normal_vectors(new)
            if len(rows) < len(self._views):  # grows by doubling: a walk adds panoramas one by one
                space = torch.empty(2 * len(self._views), *new.shape[1:])
                rows = torch.cat([rows.view(-1, *new.shape[1:])[:done], space])
            rows[done : len(self._views)] = new
            self._normal[kind] = rows, len(self._views)
        return rows[: len(self._views)]
