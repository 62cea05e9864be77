"""The optimiser of the published code: RMSProp in TensorFlow's form, and clipping variable by variable."""

from collections.abc import Callable, Iterable
from typing import Any

import torch
from torch import Tensor
from torch.optim import Optimizer


class TFRMSprop(Optimizer):
    """RMSProp as TensorFlow's ``ApplyRMSProp`` computes it.

    ``ms = alpha ms + (1 - alpha) g^2``, then ``w = w - lr g / sqrt(ms + eps)``. It differs from
    `torch.optim.RMSprop` in two ways that matter with the published ``eps`` of 0.1: epsilon is inside the root, and
    the mean square starts at one, not zero.

    Args:
        params: the parameters to optimise.
        lr: learning rate.
        alpha: decay of the mean square.
        eps: see above.
    """

    def __init__(self, params: Iterable[Any], lr: float = 7e-4, alpha: float = 0.99, eps: float = 0.1) -> None:
        super().__init__(params, {"lr": lr, "alpha": alpha, "eps": eps})

    @torch.no_grad()
    def step(self, closure: Callable[[], float] | None = None) -> float | None:  # type: ignore[override]
        """Update every parameter that has a gradient."""
        loss = None
        if closure is not None:
            with torch.enable_grad():
                loss = closure()
        for group in self.param_groups:
            parameters = [p for p in group["params"] if p.grad is not None]
            if not parameters:
                continue
            for parameter in parameters:
                if not self.state[parameter]:
                    self.state[parameter]["mean_square"] = torch.ones_like(parameter)
            gradients = [p.grad for p in parameters]
            squares = [self.state[p]["mean_square"] for p in parameters]
            torch._foreach_mul_(squares, group["alpha"])
            torch._foreach_addcmul_(squares, gradients, gradients, 1 - group["alpha"])
            roots = torch._foreach_add(squares, group["eps"])
            torch._foreach_sqrt_(roots)
            torch._foreach_addcdiv_(parameters, gradients, roots, -group["lr"])
        return loss


@torch.no_grad()
def clip_each(parameters: Iterable[Tensor], max_norm: float) -> None:
    """Scale the gradient of each variable by itself to at most ``max_norm`` (TensorFlow's ``clip_by_norm``)."""
    for parameter in parameters:
        if parameter.grad is not None:
            norm = parameter.grad.norm()
            parameter.grad.mul_(max_norm / norm.clamp(min=max_norm))
