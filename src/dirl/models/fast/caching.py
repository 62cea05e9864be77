"""Compute once what many rows share: agents in one place see the same views."""

from collections.abc import Callable

import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx


def answers_late(tensor: Tensor) -> bool:
    """Whether Python should not ask what is in a tensor: a GPU finishes all its work first, and then has none."""
    return tensor.is_cuda


def pack(views: Tensor, states: int) -> Tensor:
    """One integer for each row of views, int64 ``[B, V]`` to ``[B]``; see `unpack`.

    Args:
        views: integers below ``states``.
        states: V integers below it must fit into one int64; for V = 4, that is up to 55,108 states.

    Raises:
        ValueError: the world is too large.
    """
    slots = views.shape[1]
    if states**slots >= 2**63:
        raise ValueError(f"a world of {states} states is too large; at most 55108 can be handled together")
    keys = views[:, 0].contiguous()
    for slot in range(1, slots):
        keys = keys * states + views[:, slot]
    return keys


def unpack(keys: Tensor, states: int, slots: int) -> Tensor:
    """The rows of views that ``keys`` of `pack` stand for, int64 ``[R]`` to ``[R, slots]``."""
    return torch.stack([keys // states**power % states for power in reversed(range(slots))], -1)


class Memory:
    """Rows computed for some keys, each once. It is valid as long as what computes them stays as it is.

    Args:
        every: compute the rows of all keys below this number at once when asked for the first time, which saves
            looking up what is known; None to compute what is asked for.
    """

    def __init__(self, every: int | None = None) -> None:
        self.every = every
        self.keys = torch.empty(0, dtype=torch.int64)
        """Of the rows, int64 ``[R]``, in the order in which they were first asked for."""
        self.rows: tuple[Tensor, ...] = ()
        """What was computed for them, float ``[R, F]`` each."""
        self._sorted = self._places = self.keys

    @torch.no_grad()
    def places(self, keys: Tensor, compute: Callable[[Tensor], tuple[Tensor, ...]]) -> Tensor:
        """Where the rows of some keys are, int64 ``[K]`` to ``[K]``; those that are not there yet are computed."""
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


class KnownLinear(torch.autograd.Function):
    """A linear layer whose output is known already: only its gradients are computed."""

    @staticmethod
    def forward(ctx: FunctionCtx, x: Tensor, weight: Tensor, bias: Tensor | None, output: Tensor) -> Tensor:  # noqa: D102
        ctx.save_for_backward(x.to(output.dtype), weight.to(output.dtype))
        return output.clone()

    @staticmethod
    def backward(ctx: FunctionCtx, gradient: Tensor) -> tuple[Tensor | None, ...]:  # noqa: D102
        x, weight = ctx.saved_tensors  # type: ignore[attr-defined]
        asked = ctx.needs_input_grad  # type: ignore[attr-defined]
        return (
            gradient @ weight if asked[0] else None,
            gradient.T @ x if asked[1] else None,
            gradient.sum(0) if asked[2] else None,
            None,
        )
