"""Embed each distinct observation once: many agents share a state, and many frames share a goal.

A batch holds far fewer distinct observations than frames, and the embedding is most of the arithmetic of the network.
`CachedEncoder` works with any encoder whose ``forward(o, g)`` is ``fuse(embed(o), embed(g))``. What a rollout has
embedded is not computed again for the loss: it is computed with its graph, which the loss goes back through.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import torch
from torch import Tensor, nn

from dirl.envs.transforms import VIEWS, front_only
from dirl.models.features import FeatureTable


def reading_waits(tensor: Tensor) -> bool:
    """Return True if the CPU, to read a tensor's values, would have to wait for the device that computes them."""
    return tensor.is_cuda


NONE = torch.empty(0, dtype=torch.int64)
"""No key, or row."""


@dataclass(eq=False)
class EmbeddingCache:
    """A cache of rows by key, each computed once."""

    compute: Callable[[Tensor], Tensor]
    """The rows of distinct keys, int64 ``[R]`` to ``[R, ...]``."""
    every: int | None = None
    """Compute the rows of all keys below this number at the first use, which saves looking up what is known (and on a
    GPU a host-device synchronisation); None to compute what is needed."""
    learns: bool = False
    """Keep the graph that leads to the rows."""
    keys: Tensor = NONE
    """Of the rows, int64 ``[R]``, in the order of their first use."""
    rows: Tensor = NONE
    """What was computed for them, ``[R, ...]``."""
    sorted_keys: Tensor = NONE
    sorted_places: Tensor = NONE
    """The place among the rows of each sorted key."""

    def places(self, keys: Tensor) -> Tensor:
        """Return the place among the rows of each key, int64 ``[K]`` to ``[K]``; missing rows are computed."""
        with torch.set_grad_enabled(self.learns):
            if self.every is not None:
                if not len(self.keys):
                    self.keys = torch.arange(self.every, device=keys.device)
                    self.rows = self.compute(self.keys)
                return keys
            if not len(self.keys):
                self.keys, inverse = torch.unique(keys, return_inverse=True)
                self.rows = self.compute(self.keys)
                self.sorted_keys, self.sorted_places = self.keys, torch.arange(len(self.keys), device=keys.device)
                return inverse
            at = torch.searchsorted(self.sorted_keys, keys).clamp_(max=len(self.sorted_keys) - 1)
            new = torch.unique(keys[self.sorted_keys[at] != keys])
            if len(new):
                self.keys = torch.cat([self.keys, new])
                self.rows = torch.cat([self.rows, self.compute(new)])
                self.sorted_keys, self.sorted_places = torch.sort(self.keys)
                at = torch.searchsorted(self.sorted_keys, keys)
            return self.sorted_places[at]


def packable(ids: int, slots: int) -> bool:
    """Return True if rows of so many of so many view ids fit into one int64, as four of up to 55,108 pictures do."""
    return ids**slots < 2**63


@dataclass(frozen=True)
class Keys:
    """One integer for each row of view ids, and the row again; see `packable`."""

    ids: int
    """How many view ids there are."""
    slots: int
    """How many are in a row, V."""

    def pack(self, view_ids: Tensor) -> Tensor:
        """Return the keys of rows, int64 ``[B, V]`` to ``[B]``."""
        keys = view_ids[:, 0].contiguous()
        for slot in range(1, self.slots):
            keys = keys * self.ids + view_ids[:, slot]
        return keys

    def unpack(self, keys: Tensor) -> Tensor:
        """Return the rows that keys of `pack` stand for, int64 ``[R]`` to ``[R, V]``."""
        return torch.stack([keys // self.ids**power % self.ids for power in reversed(range(self.slots))], -1)


@runtime_checkable
class Cacheable(Protocol):
    """An encoder that can be cached: ``forward(o, g)`` equals ``fuse(embed(o), embed(g))``, row by row.

    With a method ``embed_goal`` it equals ``fuse(embed(o), embed_goal(g))``.
    """

    def embed(self, observation: Tensor) -> Tensor:
        """Embed features ``[B, 4, D]`` to ``[B, E]``."""

    def fuse(self, embedding: Tensor, goal_embedding: Tensor) -> Tensor:
        """Fuse two embeddings ``[B, E]`` to ``[B, width]``."""


class CachedEncoder(nn.Module):
    """An encoder that takes view ids instead of features, and embeds each distinct observation once.

    The encoder and the table are not its submodules: they belong to the network, whose state_dict has them once.

    Args:
        encoder: to wrap; see `Cacheable`.
        table: the features of the N states that view ids stand for.
        surrounding: the four states observed from each state, int64 ``[N, 4]``, where the observation depends on the
            state alone; None where any four states can be observed together.
        views: how many an observation has, four unless it is one of your own.
        front: whether goals may also be given by their front view alone, see `dirl.envs.SurroundingViews`.
    """

    def __init__(
        self,
        encoder: Cacheable,
        table: FeatureTable,
        surrounding: Tensor | None = None,
        *,
        views: int = VIEWS,
        front: bool = False,
    ) -> None:
        super().__init__()
        self.keys = Keys(len(table.table), views)  # where any four states can be observed together
        self._wrapped: tuple[Any, FeatureTable] = (encoder, table)  # in a tuple, which torch does not register
        self.front = front and surrounding is not None
        if front and surrounding is not None:
            surrounding = torch.cat([surrounding, front_only(surrounding, len(table))])
        self.register_buffer("surrounding", surrounding, persistent=False)
        self._keeps = self._learns = False
        self._kept: tuple[EmbeddingCache, EmbeddingCache] | None = None
        """Of observations and of goals; in a context, until a loss has gone back through them."""

    surrounding: Tensor | None

    def forward(self, view_ids: Tensor, goal_view_ids: Tensor) -> Tensor:
        """Encode view ids of observation and goal, int64 ``[B, 4]`` each, to a fused vector, float32 ``[B, width]``."""
        encoder, table = self._wrapped
        learns = torch.is_grad_enabled() or self._learns
        embed_goal = getattr(encoder, "embed_goal", None)
        if self._kept is None or not self._keeps or learns > self._kept[0].learns:
            # To find what is distinct, the CPU would wait for a GPU: there all observations are embedded at once.
            known = self.surrounding
            every = None if known is None or not reading_waits(table.table) else len(known)
            views = self.keys.unpack if known is None else known.__getitem__
            self._kept = (
                EmbeddingCache(lambda keys: encoder.embed(table(views(keys))), every, learns=learns),
                EmbeddingCache(lambda keys: (embed_goal or encoder.embed)(table(views(keys))), every, learns=learns),
            )
        seen, shown = self._kept
        if torch.is_grad_enabled() or not self._keeps:
            self._kept = None  # a graph is gone back through once
        keys, goal_keys = self._pack(view_ids), self._pack(goal_view_ids)
        if embed_goal is None:  # observations and goals are embedded alike
            place = seen.places(torch.cat([keys, goal_keys]))
            return encoder.fuse(*seen.rows.index_select(0, place).split(len(keys)))
        place, goal_place = seen.places(keys), shown.places(goal_keys)
        return encoder.fuse(seen.rows.index_select(0, place), shown.rows.index_select(0, goal_place))

    def _pack(self, view_ids: Tensor) -> Tensor:
        """Return a key for each observation, int64 ``[B, 4]`` to ``[B]``: its state, where that says all."""
        if self.surrounding is None:
            return self.keys.pack(view_ids)
        if self.front:  # states first, then goals of which only the front view is known
            unknown = len(self._wrapped[1])
            return view_ids[:, 0] + unknown * (view_ids[:, 1] == unknown)
        return view_ids[:, 0].contiguous()

    @contextmanager
    def keeping(self, *, learns: bool) -> Iterator[None]:
        """Keep embeddings to the end of this context, in which weights must not change, as in evaluation.

        Where it ``learns``, until a loss has read them; then weights may change.
        """
        self._keeps, self._learns, self._kept = True, learns, None
        try:
            yield
        finally:
            self._keeps, self._learns, self._kept = False, False, None
