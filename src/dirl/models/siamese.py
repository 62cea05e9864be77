"""The generic Siamese layers: observation and goal embedded by the same weights, then fused (paper figure 2)."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dirl.envs.transforms import VIEWS
from dirl.models.fast.caching import KnownLinear, Memory, answers_late, pack, unpack
from dirl.models.fast.principal_axes import PrincipalAxes
from dirl.models.features import FeatureTable


class SiameseEncoder(nn.Module):
    """Four views of an agent and four of its goal, to one vector.

    The embedding, 4 x 2048 -> 512, is most of the arithmetic of the network, and a batch holds far fewer distinct
    observations than frames: each is embedded once. The fusion of the concatenated embeddings, ``W [e, g] + b``, is
    computed as ``W_e e + (W_g g + b)``, each half once for each distinct row as well.

    Args:
        table: the features of the states that views are given as.
        width: of the embedding and of the fused vector.
    """

    def __init__(self, table: FeatureTable, width: int = 512) -> None:
        super().__init__()
        self.table = table
        self.axes: PrincipalAxes | None = None
        self.embedding = nn.Linear(VIEWS * table.width, width)
        self.fusion = nn.Linear(2 * width, width)
        self._remembers = False
        self._memories: tuple[Memory, Memory] | None = None
        self._versions: list[int] = []
        self._projected: Tensor | None = None

    def embed(self, features: Tensor) -> Tensor:
        """Standardised features of four views, float32 ``[..., 4, D]``, to their embedding ``[..., width]``."""
        return F.relu(self.embedding(features.flatten(-2)))

    def fuse(self, embedding: Tensor, goal_embedding: Tensor) -> Tensor:
        """Two embeddings ``[..., width]`` to the fused vector ``[..., width]``."""
        return F.relu(self.fusion(torch.cat([embedding, goal_embedding], -1)))

    def forward(self, views: Tensor, goal_views: Tensor) -> Tensor:
        """States seen, int64 ``[B, 4]`` each, to the fused vector, float32 ``[B, width]``."""
        states, slots = len(self.table), self._slots
        keys, goal_keys = pack(views[:, :slots], states), pack(goal_views[:, :slots], states)
        weight, goal_weight = self.fusion.weight.chunk(2, 1)
        known, goals = self._recall()

        def halves(keys: Tensor) -> tuple[Tensor, Tensor]:
            embedded = self._embed(unpack(keys, states, slots))
            return embedded, F.linear(F.relu(embedded), weight)

        def goal_halves(keys: Tensor) -> tuple[Tensor]:
            place = known.places(keys, halves)
            return (F.linear(F.relu(known.rows[0][place]), goal_weight, self.fusion.bias),)

        place = known.places(torch.cat([keys, goal_keys]), halves)[: len(keys)]
        goal_place = goals.places(goal_keys, goal_halves)
        (embedded, half), (goal_half,) = known.rows, goals.rows
        if torch.is_grad_enabled():
            inputs = self._inputs(unpack(known.keys, states, slots))
            embedding = F.relu(KnownLinear.apply(inputs, self.embedding.weight, self.embedding.bias, embedded))
            half = KnownLinear.apply(embedding, weight, None, half)
            goal_embedding = embedding[known.places(goals.keys, halves)]
            goal_half = KnownLinear.apply(goal_embedding, goal_weight, self.fusion.bias, goal_half)
        return F.relu(half.index_select(0, place) + goal_half.index_select(0, goal_place))

    def _embed(self, views: Tensor) -> Tensor:
        """Rows of views int64 ``[R, slots]`` to their embedding before the ReLU, float32 ``[R, width]``."""
        if self._projected is None:
            return self.embedding(self._inputs(views))
        slots = torch.arange(self._slots, device=views.device)
        return self._projected[views, slots].sum(1) + self.embedding.bias

    def _inputs(self, views: Tensor) -> Tensor:
        return self.table(views).flatten(-2) if self.axes is None else self.axes(views)

    @property
    def _slots(self) -> int:
        """How many of the four views tell everything that is seen."""
        return VIEWS if self.axes is None else self.axes.slots

    def _recall(self) -> tuple[Memory, Memory]:
        # Every in-place change, such as an optimiser's step, counts a version up.
        versions = [parameter._version for parameter in self.parameters()]
        if self._memories is None or not self._remembers or versions != self._versions:
            # Asking what is not known yet takes longer than computing all there is.
            every = len(self.table) if self._slots == 1 and answers_late(self.table.table) else None
            self._memories, self._versions = (Memory(every), Memory(every)), versions
        return self._memories

    @contextmanager
    def remembering(self) -> Iterator[None]:
        """Within this context no observation is embedded twice between two changes of the weights.

        What a rollout embedded without gradients is used by the loss that follows, with gradients.
        """
        self._remembers, self._memories = True, None
        try:
            yield
        finally:
            self._remembers, self._memories = False, None

    @contextmanager
    def projecting(self) -> Iterator[None]:
        """Within this context the whole world is projected once, for evaluation. The weights must not change.

        The embedding is a sum of projections, one for each view's slot, so that any four views are then embedded by
        adding four rows. Equal to the direct form up to rounding.
        """
        table = self.table.table if self.axes is None else self.axes.table
        weight = self.embedding.weight.detach().unflatten(1, (self._slots, -1))
        self._projected = torch.stack([F.linear(table, of_slot) for of_slot in weight.unbind(1)], 1)
        try:
            yield
        finally:
            self._projected = None

    @torch.no_grad()
    def use_principal_axes(self, surrounding: Tensor | None) -> None:
        """Go on in the principal axes of the features, see `PrincipalAxes`; to be called before an optimiser is made.

        The weights are others, what they compute is not. But an optimiser that scales every weight by itself, as Adam
        does, takes other ways from here.
        """
        self.axes = PrincipalAxes(self.table.table, surrounding, self.embedding.weight)
        self.embedding = _linear(self.axes.narrow(self.embedding.weight), self.embedding.bias)

    @torch.no_grad()
    def use_features(self) -> None:
        """Undo `use_principal_axes`; what was learnt since stays."""
        self.embedding = _linear(self.weight_on_features(), self.embedding.bias)
        self.axes = None

    @torch.no_grad()
    def weight_on_features(self) -> Tensor:
        """The weight of the embedding without principal axes, float32 ``[width, 4 * D]``."""
        weight = self.embedding.weight.detach()
        return weight if self.axes is None else self.axes.widen(weight)


def _linear(weight: Tensor, bias: Tensor) -> nn.Linear:
    layer = nn.Linear(weight.shape[1], len(weight), device="meta")
    layer.weight, layer.bias = nn.Parameter(weight.detach()), nn.Parameter(bias.detach())
    return layer
