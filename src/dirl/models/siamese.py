"""The generic Siamese layers: observation and goal embedded by the same weights, then fused (paper figure 2)."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dirl.envs.transforms import VIEWS
from dirl.models.features import FeatureTable
from dirl.models.rows import KnownLinear, Memory, distinct, unpack


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
        self.embedding = nn.Linear(VIEWS * table.width, width)
        self.fusion = nn.Linear(2 * width, width)
        self._memory: Memory | None = None
        self._memory_version = -1
        self._projected: Tensor | None = None

    def embed(self, features: Tensor) -> Tensor:
        """Standardised features of four views, float32 ``[..., 4, D]``, to their embedding ``[..., width]``."""
        return F.relu(self.embedding(features.flatten(-2)))

    def fuse(self, embedding: Tensor, goal_embedding: Tensor) -> Tensor:
        """Two embeddings ``[..., width]`` to the fused vector ``[..., width]``."""
        return F.relu(self.fusion(torch.cat([embedding, goal_embedding], -1)))

    def forward(self, views: Tensor, goal_views: Tensor) -> Tensor:
        """States seen, int64 ``[B, 4]`` each, to the fused vector, float32 ``[B, width]``."""
        keys, row = distinct(views, len(self.table))
        goal_keys, goal_row = distinct(goal_views, len(self.table))
        embedding = F.relu(self._embed_known(torch.cat([keys, goal_keys])))
        width = self.embedding.out_features
        half = F.linear(embedding[: len(keys)], self.fusion.weight[:, :width])
        goal_half = F.linear(embedding[len(keys) :], self.fusion.weight[:, width:], self.fusion.bias)
        return F.relu(half.index_select(0, row) + goal_half.index_select(0, goal_row))

    @contextmanager
    def remembering(self) -> Iterator[None]:
        """Within this context no observation is embedded twice between two changes of the weights.

        What a rollout embedded without gradients is used by the loss that follows, with gradients.
        """
        self._memory = Memory()
        try:
            yield
        finally:
            self._memory = None

    @contextmanager
    def projecting(self) -> Iterator[None]:
        """Within this context the whole world is projected once, for evaluation. The weights must not change.

        The embedding is a sum of four projections, one for each view's slot, so that any four views are then
        embedded by adding four rows. Equal to the direct form up to rounding.
        """
        weight = self.embedding.weight.detach().unflatten(1, (VIEWS, self.table.width))
        self._projected = torch.stack([F.linear(self.table.table, weight[:, slot]) for slot in range(VIEWS)], 1)
        try:
            yield
        finally:
            self._projected = None

    def _embed_known(self, keys: Tensor) -> Tensor:
        """The embeddings of packed rows of views before the ReLU, int64 ``[R]`` to float32 ``[R, width]``."""
        if self._projected is not None:
            views = unpack(keys, len(self.table))
            slots = torch.arange(VIEWS, device=keys.device)
            return self._projected[views, slots].sum(1) + self.embedding.bias
        if self._memory is None:
            return self._embed_rows(keys)
        version = self.embedding.weight._version  # every in-place change, such as an optimiser's step, counts it up
        if version != self._memory_version:
            self._memory, self._memory_version = Memory(), version
        if not torch.is_grad_enabled():
            return self._memory.look_up(keys, self._embed_rows)
        unique, inverse = torch.unique(keys, return_inverse=True)
        known = self._memory.look_up(unique, self._embed_rows)
        features = self.table(unpack(unique, len(self.table))).flatten(-2)
        rows = KnownLinear.apply(features, self.embedding.weight, self.embedding.bias, known)
        return rows.index_select(0, inverse)

    def _embed_rows(self, keys: Tensor) -> Tensor:
        return self.embedding(self.table(unpack(keys, len(self.table))).flatten(-2))
