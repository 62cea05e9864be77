"""The generic Siamese layers: observation and goal embedded by the same weights, then fused (paper figure 2)."""

from typing import Annotated

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dirl.config.bounds import Bounds
from dirl.envs.transforms import VIEWS


class SiameseEncoder(nn.Module):
    """Encode four views of the agent and four of the goal as one vector.

    Args:
        num_features: D, of a view.
        width: of the embedding and of the fused vector.
        num_views: how many an observation has.
    """

    def __init__(
        self, num_features: int, width: Annotated[int, Bounds(1, 65_536)] = 512, num_views: int = VIEWS
    ) -> None:
        super().__init__()
        self.width, self.num_views = width, num_views
        self.embedding = nn.Linear(num_views * num_features, width)
        self.fusion = nn.Linear(2 * width, width)

    def embed(self, observation: Tensor) -> Tensor:
        """Features of four views, float32 ``[..., 4, D]``, to their embedding ``[..., width]``."""
        return F.relu(self.embedding(observation.flatten(-2)))

    def fuse(self, embedding: Tensor, goal_embedding: Tensor) -> Tensor:
        """The embeddings of observation and goal, ``[..., width]`` each, to the fused vector ``[..., width]``."""
        return F.relu(self.fusion(torch.cat([embedding, goal_embedding], -1)))

    def forward(self, observation: Tensor, goal_observation: Tensor) -> Tensor:
        """Features of observation and goal, float32 ``[..., 4, D]`` each, to the fused vector ``[..., width]``."""
        embedding, goal_embedding = self.embed(torch.stack([observation, goal_observation])).unbind()
        return self.fuse(embedding, goal_embedding)
