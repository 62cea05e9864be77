"""Embed each distinct observation once: many agents share a state, and many frames share a goal.

A batch holds far fewer distinct observations than frames, and the embedding, 4 x 2048 -> 512, is most of the arithmetic
of the network. `CachedEncoder` works with any encoder whose ``forward(o, g)`` is ``fuse(embed(o), embed(g))``.
"""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any, Protocol, runtime_checkable

import torch
from torch import Tensor, nn
from torch._C._functorch import is_batchedtensor  # tensordict hands it on up to 0.14 only; nothing public says it

from dirl.envs.transforms import VIEWS, front_only
from dirl.models.features import FeatureTable


def avoid_host_sync(tensor: Tensor) -> bool:
    """Whether reading a tensor's values would synchronise with a device, or is impossible (in ``vmap``)."""
    return tensor.is_cuda or is_batchedtensor(tensor)


class EmbeddingCache:
    """A cache of rows by key, each computed once; valid until the weights that compute them change.

    Args:
        every: compute the rows of all keys below this number at the first use, which saves looking up what is known
            (and on a GPU a host-device synchronisation); None to compute what is needed.
    """

    def __init__(self, every: int | None = None) -> None:
        self.every = every
        self.keys = torch.empty(0, dtype=torch.int64)
        """Of the rows, int64 ``[R]``, in the order of their first use."""
        self.rows: tuple[Tensor, ...] = ()
        """What was computed for them, float ``[R, F]`` each."""
        self._sorted = self._places = self.keys

    @torch.no_grad()
    def places(self, keys: Tensor, compute: Callable[[Tensor], tuple[Tensor, ...]]) -> Tensor:
        """The place among the rows of each key, int64 ``[K]`` to ``[K]``; missing rows are computed."""
        if self.every is not None:
            if not self.rows:
                self.keys = torch.arange(self.every, device=keys.device)
                self.rows = compute(self.keys)
            return keys
        if not self.rows:
            self.keys, inverse = torch.unique(keys, return_inverse=True)
            self.rows = compute(self.keys)
            self._sorted, self._places = self.keys, torch.arange(len(self.keys), device=keys.device)
            return inverse
        at = torch.searchsorted(self._sorted, keys).clamp_(max=len(self._sorted) - 1)
        new = torch.unique(keys[self._sorted[at] != keys])
        if len(new):
            self.keys = torch.cat([self.keys, new])
            self.rows = tuple(torch.cat(pair) for pair in zip(self.rows, compute(new), strict=True))
            self._sorted, self._places = torch.sort(self.keys)
            at = torch.searchsorted(self._sorted, keys)
        return self._places[at]


class Keys:
    """One integer for each row of view ids, and the row again.

    Four ids of up to 55,108 pictures are packed into one int64. Of longer rows, as those of a stack of observations,
    the halves are numbered in the order in which they were first seen.

    Args:
        ids: how many view ids there are.
        slots: V, how many are in a row.
    """

    def __init__(self, ids: int, slots: int) -> None:
        self.ids, self.slots = ids, slots
        self.halves: list[tuple[Keys, EmbeddingCache]] = []
        if ids**slots >= 2**63:
            self.halves = [(Keys(ids, part), EmbeddingCache()) for part in (slots // 2, slots - slots // 2)]

    def forget(self) -> None:
        """Number anew, so that numbers, and the order of what is computed by them, do not depend on earlier updates."""
        self.halves = [(Keys(half.ids, half.slots), EmbeddingCache()) for half, _ in self.halves]

    def pack(self, view_ids: Tensor) -> Tensor:
        """The keys of rows, int64 ``[B, V]`` to ``[B]``."""
        if self.halves:
            parts = zip(self.halves, view_ids.split([half.slots for half, _ in self.halves], 1), strict=True)
            first, second = (
                numbers.places(half.pack(part), lambda keys, half=half: (half.unpack(keys),))  # type: ignore[misc]
                for (half, numbers), part in parts
            )
            return first << 32 | second
        keys = view_ids[:, 0].contiguous()
        for slot in range(1, self.slots):
            keys = keys * self.ids + view_ids[:, slot]
        return keys

    def unpack(self, keys: Tensor) -> Tensor:
        """The rows that keys of `pack` stand for, int64 ``[R]`` to ``[R, V]``."""
        if self.halves:
            places = (keys >> 32, keys & (2**32 - 1))
            return torch.cat([n.rows[0][place] for (_, n), place in zip(self.halves, places, strict=True)], 1)
        return torch.stack([keys // self.ids**power % self.ids for power in reversed(range(self.slots))], -1)


@runtime_checkable
class Cacheable(Protocol):
    """An encoder that can be cached: ``forward(o, g)`` equals ``fuse(embed(o), embed(g))``, row by row.

    With a method ``embed_goal`` it equals ``fuse(embed(o), embed_goal(g))``.
    """

    def embed(self, observation: Tensor) -> Tensor:
        """Features ``[B, 4, D]`` to ``[B, E]``."""

    def fuse(self, embedding: Tensor, goal_embedding: Tensor) -> Tensor:
        """``[B, E]`` twice, to ``[B, width]``."""

    def parameters(self) -> Iterator[nn.Parameter]:
        """As of every module."""


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
        self.keys = Keys(len(table.table), views if surrounding is None else 1)
        self._wrapped: tuple[Any, FeatureTable] = (encoder, table)  # in a tuple, which torch does not register
        self.front = front and surrounding is not None
        if front and surrounding is not None:
            surrounding = torch.cat([surrounding, front_only(surrounding, len(table))])
        self.register_buffer("surrounding", surrounding, persistent=False)
        self._keeps = False
        self._cache: Any = None
        self._versions: list[int] = []

    surrounding: Tensor | None

    def forward(self, view_ids: Tensor, goal_view_ids: Tensor) -> Tensor:
        """View ids of observation and goal, int64 ``[B, 4]`` each, to the fused vector, float32 ``[B, width]``."""
        encoder, _ = self._wrapped
        if not self._keeps:
            self.keys.forget()
        keys, goal_keys = self._pack(view_ids), self._pack(goal_view_ids)
        known, goals = (None, None) if torch.is_grad_enabled() else self._valid_cache()
        if hasattr(encoder, "embed_goal"):
            seen, shown = self._rows(keys, encoder.embed, known), self._rows(goal_keys, encoder.embed_goal, goals)
        else:
            seen, shown = self._rows(torch.cat([keys, goal_keys]), encoder.embed, known).split(len(keys))
        return encoder.fuse(seen, shown)

    def _rows(self, keys: Tensor, embed: Callable[[Tensor], Tensor], cache: EmbeddingCache | None) -> Tensor:
        """The embedding of each key, int64 ``[K]`` to ``[K, E]``; every distinct one is computed once."""
        table = self._wrapped[1]

        def compute(distinct: Tensor) -> tuple[Tensor]:
            return (embed(table(self._views(distinct))),)

        if cache is None:
            distinct, place = torch.unique(keys, return_inverse=True)
            return compute(distinct)[0][place]
        place = cache.places(keys, compute)
        return cache.rows[0][place]

    def _pack(self, view_ids: Tensor) -> Tensor:
        """A key for each observation, int64 ``[B, 4]`` to ``[B]``."""
        unknown = len(self._wrapped[1])
        if self.front:  # states first, then goals of which only the front view is known
            return view_ids[:, 0] + unknown * (view_ids[:, 1] == unknown)
        return self.keys.pack(view_ids[:, : self.keys.slots])

    def _views(self, keys: Tensor) -> Tensor:
        """The view ids of keys, int64 ``[R]`` to ``[R, 4]``."""
        return self.keys.unpack(keys) if self.surrounding is None else self.surrounding[keys]

    def _valid_cache(self) -> Any:
        """The cache, a new one if the weights have changed: each in-place change counts a tensor's version up."""
        versions = [parameter._version for parameter in self._wrapped[0].parameters()]
        if self._cache is None or not self._keeps or versions != self._versions:
            known = self.surrounding is not None and avoid_host_sync(self._wrapped[1].table)
            every = len(self.surrounding) if known else None  # type: ignore[arg-type]
            # For observations, and for goals that are embedded otherwise.
            self._cache, self._versions = (EmbeddingCache(every), EmbeddingCache(every)), versions
        return self._cache

    @contextmanager
    def caching(self) -> Iterator[None]:
        """A context in which embeddings computed without gradients are kept until the weights change."""
        self._keeps, self._cache = True, None
        self.keys.forget()
        try:
            yield
        finally:
            self._keeps, self._cache = False, None

    def frozen(self) -> AbstractContextManager[None]:
        """A context for evaluation, in which the weights must not change."""
        return self.caching()
