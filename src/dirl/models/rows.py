"""Compute once what many rows share: agents in one place see the same views."""

from collections.abc import Callable

import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx

SLOTS = 4


def distinct(views: Tensor, states: int) -> tuple[Tensor, Tensor]:
    """The distinct rows of views.

    Args:
        views: integers below ``states``, int64 ``[B, 4]``.
        states: four integers below it must fit into one int64, which holds up to 55,108 states.

    Returns:
        One integer for each distinct row, ascending, int64 ``[R]`` (see `unpack`), and which of them each row is,
        int64 ``[B]``.

    Raises:
        ValueError: the world is too large.
    """
    if states**SLOTS >= 2**63:
        raise ValueError(f"a world of {states} states is too large; at most 55108 can be handled together")
    keys = views[:, 0]
    for slot in range(1, SLOTS):
        keys = keys * states + views[:, slot]
    return torch.unique(keys, return_inverse=True)


def unpack(keys: Tensor, states: int) -> Tensor:
    """The rows of views that ``keys`` of `distinct` stand for, int64 ``[R]`` to ``[R, 4]``."""
    return torch.stack([keys // states**power % states for power in reversed(range(SLOTS))], -1)


class Memory:
    """Values computed for some keys. It is valid as long as what computes them stays as it is."""

    def __init__(self) -> None:
        self.keys: Tensor | None = None
        """What is known, ascending, int64 ``[R]``."""
        self.places: Tensor
        """Where in ``values`` the value of each key is, int64 ``[R]``."""
        self.values: Tensor
        """float ``[R, F]``."""

    @torch.no_grad()
    def look_up(self, keys: Tensor, compute: Callable[[Tensor], Tensor]) -> Tensor:
        """The values of distinct keys, int64 ``[K]`` to ``[K, F]``; those not yet known are computed."""
        if self.keys is None:
            self.keys, self.places = torch.sort(keys)
            self.values = compute(keys)
            return self.values
        at = torch.searchsorted(self.keys, keys).clamp(max=len(self.keys) - 1)
        new = keys[self.keys[at] != keys]
        if len(new):
            places = torch.arange(len(self.values), len(self.values) + len(new), device=keys.device)
            self.values = torch.cat([self.values, compute(new)])
            self.keys, order = torch.sort(torch.cat([self.keys, new]))
            self.places = torch.cat([self.places, places])[order]
            at = torch.searchsorted(self.keys, keys)
        return self.values[self.places[at]]


class KnownLinear(torch.autograd.Function):
    """A linear layer whose output is known already: only its gradient is computed, in one matrix product."""

    @staticmethod
    def forward(ctx: FunctionCtx, x: Tensor, weight: Tensor, bias: Tensor, output: Tensor) -> Tensor:  # noqa: D102
        ctx.save_for_backward(x)
        return output.clone()

    @staticmethod
    def backward(ctx: FunctionCtx, gradient: Tensor) -> tuple[None, Tensor, Tensor, None]:  # noqa: D102
        (x,) = ctx.saved_tensors  # type: ignore[attr-defined]
        return None, gradient.T @ x, gradient.sum(0), None
