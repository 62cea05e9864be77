"""An encoder that compares the patches and views of the observation with those of the goal."""

from typing import Annotated

import torch
import torch.nn.functional as F
from annotated_types import Interval
from torch import Tensor, nn

from dirl.envs.transforms import VIEWS

SCALE = 5.0
"""Of the cosines, so that the layers on them learn as fast as the others."""


class ComparingEncoder(nn.Module):
    """Encode four views of the agent and up to four of the goal; the goal enters by comparison only.

    The observation is embedded, as in the paper. The goal is not: a network that reads an embedding of its goal
    memorises the trained goals and fails at others (docs/results_any_goal.md). Instead, every patch of the observed
    views is compared with every patch of the goal's, and every observed view with every view of the goal, by cosines of
    learned projections. Layers read each of the two matrices.

    With ``pair_width`` the same layers read the cosines of patches of each of the 16 pairs of views, and one layer
    reads their outputs. The match of two views tells their relative pose, whichever views they are. Shared layers learn
    that from every pair, which helps most where the goal is a single photo.

    Views of the goal that are not known are zeros; their cosines are zeros, as the projections have no bias.

    Args:
        num_features: of a view, its patches included.
        patch_shape: patches of a view and channels of a patch, ``(C, Q)``; they follow the P pooled features.
        width: of the embedding and of the fused vector.
        comparison: width of the layer that reads the cosines of patches.
        projection: width in which patches are compared.
        view_projection: width in which views are compared.
        pair_width: width in which the patches of a pair of views are read; 0, for checkpoints that do not name it,
            reads the cosines of all pairs at once.
    """

    def __init__(
        self,
        num_features: int,
        patch_shape: tuple[int, int],
        width: Annotated[int, Interval(ge=1, le=65_536)] = 512,
        comparison: Annotated[int, Interval(ge=1, le=65_536)] = 256,
        projection: Annotated[int, Interval(ge=1, le=4096)] = 32,
        view_projection: Annotated[int, Interval(ge=1, le=4096)] = 64,
        pair_width: Annotated[int, Interval(ge=0, le=4096)] = 0,
    ) -> None:
        super().__init__()
        cells, channels = patch_shape
        pooled = num_features - cells * channels
        self.patch_shape, self.width = (cells, channels), width
        self.sizes = [VIEWS * cells * projection, VIEWS * view_projection]
        """Of what is compared: patches, views."""
        self.embedding = nn.Linear(VIEWS * pooled, width)
        self.observation = nn.Linear(width, width)
        self.patch_projection = nn.Linear(channels, projection, bias=False)
        self.pair_cosines: nn.Module | None = None
        if pair_width:
            layers = [nn.Linear(cells**2, 2 * pair_width), nn.ReLU(), nn.Linear(2 * pair_width, pair_width), nn.ReLU()]
            self.pair_cosines = nn.Sequential(*layers)
        self.patch_cosines = nn.Linear(VIEWS**2 * (pair_width or cells**2), comparison)
        self.patch_fusion = nn.Linear(comparison, width, bias=False)
        self.view_projection = nn.Linear(pooled, view_projection, bias=False)
        self.view_cosines = nn.Linear(VIEWS**2, view_projection)
        self.view_fusion = nn.Linear(view_projection, width, bias=False)

    def embed(self, observation: Tensor) -> Tensor:
        """Return what depends on an observation alone, float32 ``[B, 4, D]`` to ``[B, width + E]``."""
        pooled, _ = self._parts(observation)
        seen = self.observation(F.relu(self.embedding(pooled.flatten(-2))))
        return torch.cat([seen, self.embed_goal(observation)], -1)

    def embed_goal(self, goal_observation: Tensor) -> Tensor:
        """Return what is compared of a goal, float32 ``[B, 4, D]`` to ``[B, E]``: its patches, then its views."""
        pooled, patches = self._parts(goal_observation)
        patches = F.normalize(self.patch_projection(patches.unflatten(-1, self.patch_shape)), dim=-1)
        views = F.normalize(self.view_projection(pooled), dim=-1)
        return torch.cat([patches.flatten(-3), views.flatten(-2)], -1)

    def fuse(self, embedding: Tensor, goal_embedding: Tensor) -> Tensor:
        """Fuse embeddings of observation and goal, ``[B, width + E]`` and ``[B, E]``, to a vector ``[B, width]``."""
        seen, *compared = embedding.split([self.width, *self.sizes], -1)
        (patches, views), (goal_patches, goal_views) = compared, goal_embedding.split(self.sizes, -1)
        cosines = _cosines(patches, goal_patches, VIEWS * self.patch_shape[0])
        if self.pair_cosines is not None:
            # By pair of an observed and a goal view, [B, 16, C^2].
            by_view = cosines.unflatten(-1, (VIEWS, self.patch_shape[0]) * 2).transpose(-3, -2)
            cosines = self.pair_cosines(by_view.flatten(-2).flatten(-3, -2)).flatten(-2)
        by_patch = self.patch_fusion(F.relu(self.patch_cosines(cosines)))
        by_view = self.view_fusion(F.relu(self.view_cosines(_cosines(views, goal_views, VIEWS))))
        return F.relu(seen + by_patch + by_view)

    def _parts(self, observation: Tensor) -> list[Tensor]:
        """Return pooled features and patches of views."""
        patches = self.patch_shape[0] * self.patch_shape[1]
        return list(observation.split([observation.shape[-1] - patches, patches], -1))

    def forward(self, observation: Tensor, goal_observation: Tensor) -> Tensor:
        """Encode features of observation and goal, float32 ``[B, 4, D]`` each, to the fused vector ``[B, width]``."""
        return self.fuse(self.embed(observation), self.embed_goal(goal_observation))


def _cosines(seen: Tensor, goal: Tensor, count: int) -> Tensor:
    """Return scaled cosines of ``count`` vectors with as many others, ``[B, count * width]``, as ``[B, count**2]``."""
    products = seen.unflatten(-1, (count, -1)) @ goal.unflatten(-1, (count, -1)).transpose(-1, -2)
    return SCALE * products.flatten(-2)
