"""`SiameseEncoder` with far fewer operations: cached outputs, and matrix products with fewer columns."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.autograd.function import FunctionCtx

from dirl.models.fast.caching import CachedEncoder
from dirl.models.fast.principal_axes import PrincipalAxes
from dirl.models.features import FeatureTable
from dirl.models.siamese import SiameseEncoder


class CachedSiamese(CachedEncoder):
    """The Siamese encoder on view ids.

    - Each distinct observation is embedded once, and the loss uses what the rollout embedded.
    - The fusion of the concatenated embeddings, ``W [e, g] + b``, is computed as ``W_e e + (W_g g + b)``, each half
      once for each distinct row as well.
    - In principal axes the embedding has a column for each axis instead of each feature, see `PrincipalAxes`.

    It takes what `CachedEncoder` does, and:

    Args:
        principal: learn the embedding in principal axes, as an `AxesLinear` until `restore`; not with ``front``.
    """

    def __init__(
        self,
        encoder: SiameseEncoder,
        table: FeatureTable,
        surrounding: Tensor | None,
        *,
        principal: bool = False,
        **read: Any,
    ) -> None:
        super().__init__(encoder, table, surrounding, **read)
        self.axes: PrincipalAxes | None = None
        self._projected: Tensor | None = None
        if principal:
            with torch.no_grad():
                hidden = surrounding is not None and bool((surrounding == len(table)).any())  # views that are not shown
                rows = table.table if hidden else table.known
                self.axes = PrincipalAxes(rows, surrounding, encoder.embedding.weight)
                layer = AxesLinear(self.axes, encoder.embedding.weight, encoder.embedding.bias)
                encoder.embedding = layer  # type: ignore[assignment]

    @torch.no_grad()
    def restore(self) -> None:
        """Convert the encoder's embedding back to a layer on features, with the learned weights."""
        encoder, _ = self._wrapped
        weight, bias = self.weight_on_features(), encoder.embedding.bias
        encoder.embedding = nn.Linear(weight.shape[1], len(weight), device="meta")
        encoder.embedding.weight, encoder.embedding.bias = nn.Parameter(weight.detach()), nn.Parameter(bias.detach())
        self.axes = None

    @torch.no_grad()
    def weight_on_features(self) -> Tensor:
        """The weight of the embedding as a layer on features, float32 ``[width, 4 * D]``."""
        weight: Tensor = self._wrapped[0].embedding.weight.detach()
        return weight if self.axes is None else self.axes.widen(weight)

    def forward(self, view_ids: Tensor, goal_view_ids: Tensor) -> Tensor:
        """View ids of observation and goal, int64 ``[B, 4]`` each, to the fused vector, float32 ``[B, width]``."""
        encoder, _ = self._wrapped
        keys, goal_keys = self._pack(view_ids), self._pack(goal_view_ids)
        weight, goal_weight = encoder.fusion.weight.chunk(2, 1)
        known, goals = self._valid_cache()

        def halves(keys: Tensor) -> tuple[Tensor, Tensor]:
            embedded = self._embed(keys)
            return embedded, F.linear(F.relu(embedded), weight)

        def goal_halves(keys: Tensor) -> tuple[Tensor]:
            place = known.places(keys, halves)
            return (F.linear(F.relu(known.rows[0][place]), goal_weight, encoder.fusion.bias),)

        place = known.places(torch.cat([keys, goal_keys]), halves)[: len(keys)]
        goal_place = goals.places(goal_keys, goal_halves)
        (embedded, half), (goal_half,) = known.rows, goals.rows
        if torch.is_grad_enabled():
            inputs = self._inputs(self._views(known.keys))
            embedding = F.relu(KnownLinear.apply(inputs, encoder.embedding.weight, encoder.embedding.bias, embedded))
            half = KnownLinear.apply(embedding, weight, None, half)
            goal_embedding = embedding[known.places(goals.keys, halves)]
            goal_half = KnownLinear.apply(goal_embedding, goal_weight, encoder.fusion.bias, goal_half)
        return F.relu(half.index_select(0, place) + goal_half.index_select(0, goal_place))

    def _embed(self, keys: Tensor) -> Tensor:
        """The embedding before the ReLU, float32 ``[R, width]``, of keys int64 ``[R]``."""
        encoder, views = self._wrapped[0], self._views(keys)
        if self._projected is None:
            layer = encoder.embedding if self.axes is None else encoder.embedding.of_coordinates
            return layer(self._inputs(views))
        slots = self._projected.shape[1]
        return (
            self._projected[views[:, :slots], torch.arange(slots, device=views.device)].sum(1) + encoder.embedding.bias
        )

    def _inputs(self, view_ids: Tensor) -> Tensor:
        """The inputs of the embedding, int64 ``[R, 4]`` to float32 ``[R, columns]``."""
        return self._wrapped[1](view_ids).flatten(-2) if self.axes is None else self.axes(view_ids)

    @contextmanager
    def frozen(self) -> Iterator[None]:
        """A context for evaluation, in which the weights must not change: all states are projected once.

        The embedding is a sum of projections, one for each of the four views, so that any four views are then embedded
        by adding four rows. Equal to the plain form up to rounding.
        """
        table, slots = self._wrapped[1].table[: len(self._wrapped[1]) + 1], self._wrapped[0].num_views
        if self.axes is not None:
            table, slots = self.axes.table, self.axes.slots
        weight = self._wrapped[0].embedding.weight.detach().unflatten(1, (slots, -1))
        self._projected = torch.stack([F.linear(table, of_slot) for of_slot in weight.unbind(1)], 1)
        try:
            yield
        finally:
            self._projected = None


class AxesLinear(nn.Module):
    """A linear layer on features whose weight, float32 ``[F, 4 * D]``, is learned in principal axes; bias ``[F]``."""

    def __init__(self, axes: PrincipalAxes, weight: Tensor, bias: Tensor) -> None:
        super().__init__()
        self._axes = (axes,)  # in a tuple, so that they are no submodule of the layer too
        self.weight = nn.Parameter(axes.narrow(weight.detach()))
        self.bias = nn.Parameter(bias.detach())

    def of_coordinates(self, coordinates: Tensor) -> Tensor:
        """What `forward` computes, of coordinates in the axes, float32 ``[..., slots * R]``."""
        return F.linear(coordinates, self.weight, self.bias)

    def forward(self, features: Tensor) -> Tensor:
        """Features, float32 ``[..., 4 * D]``, to ``[..., F]``; slow, for whoever calls the encoder itself."""
        return F.linear(features, self._axes[0].widen(self.weight), self.bias)


class KnownLinear(torch.autograd.Function):
    """A linear layer whose output has been computed before: only its gradients are computed."""

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
