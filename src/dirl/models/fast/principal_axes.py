"""The embedding in the principal axes of all possible observations: the same layer with far fewer operations."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dirl.envs.transforms import VIEWS

DEPENDENT = 1e-9
"""An axis with less than this fraction of the first one's variance holds nothing but rounding errors."""


class PrincipalAxes(nn.Module):
    """The inputs of the embedding, as coordinates in the axes of their span.

    The N states of a world give N rows of 4 x D features, if all that is seen depends on the state alone. They span
    at most N dimensions, so that a linear layer on their coordinates needs at most N columns instead of 4 x D. What
    the layer makes of anything outside that span cannot be learned from these rows and stays as it is. With views of
    the past any four states can be seen together: then each view has coordinates of its own.

    Args:
        features: standardised, of N states, float32 ``[N, D]``, followed by a row of zeros where views are hidden.
        surrounding: the four states seen from each state, int64 ``[N, 4]``, if they are all that is ever seen
            there; None if any four states can be seen.
        weight: of the embedding as it begins, float32 ``[F, 4 * D]``.
    """

    def __init__(self, features: Tensor, surrounding: Tensor | None, weight: Tensor) -> None:
        super().__init__()
        weight = weight.detach()  # `beside` is data: with a graph behind it no copy of the network could be made
        self.slots = VIEWS if surrounding is None else 1
        products = features.double() @ features.T.double()
        if surrounding is not None:
            products = torch.stack([products[states][:, states] for states in surrounding.unbind(1)]).sum(0)
        variance, axes = torch.linalg.eigh(products)
        kept = variance > DEPENDENT * variance[-1]
        # In the state_dict, because another machine finds other axes where two are nearly equally long.
        self.register_buffer("table", (axes[:, kept] * variance[kept].sqrt()).to(features.dtype))
        self.register_buffer("features", features, persistent=False)
        self.register_buffer("surrounding", surrounding, persistent=False)
        self.register_buffer("beside", torch.zeros_like(weight), persistent=False)
        self.beside = weight - self.widen(self.narrow(weight))

    table: Tensor
    """Coordinates of a state's row, float32 ``[N, R]``."""
    features: Tensor
    surrounding: Tensor | None
    beside: Tensor
    """What is multiplied with the part of any features that lies outside the axes."""

    def forward(self, view_ids: Tensor) -> Tensor:
        """The coordinates of observations, int64 ``[..., 4]`` to float32 ``[..., slots * R]``."""
        return F.embedding(view_ids[..., : self.slots], self.table).flatten(-2)

    def narrow(self, weight: Tensor) -> Tensor:
        """A layer's weight on features, float32 ``[F, 4 * D]``, as weight on coordinates, ``[F, slots * R]``."""
        return (weight.unflatten(1, (self.slots, -1)) @ self._rows().T @ self._unscaled()).flatten(1)

    def widen(self, weight: Tensor) -> Tensor:
        """The weight on features that is equivalent to a weight on coordinates; the inverse of `narrow` on the rows."""
        return self.beside + (weight.unflatten(1, (self.slots, -1)) @ self._unscaled().T @ self._rows()).flatten(1)

    def _rows(self) -> Tensor:
        """The rows that were given axes, float32 ``[N, 4 * D]`` or ``[N, D]``."""
        return self.features if self.surrounding is None else self.features[self.surrounding].flatten(-2)

    def _unscaled(self) -> Tensor:
        return self.table / self.table.square().sum(0)
