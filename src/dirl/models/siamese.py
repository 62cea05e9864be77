"""The generic Siamese layers: observation and goal embedded by the same weights, then fused (paper figure 2)."""

from typing import Annotated, ClassVar

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dirl.config.bounds import Bounds
from dirl.envs.transforms import VIEWS


class SiameseEncoder(nn.Module):
    """Encode four views of the agent and four of the goal as one vector.

    Observation and goal are embedded by the same layer; the next layer fuses both embeddings, ``W [e, g] + b``. This is
    ``(W_e e + b) + W_g g``, so that it is two layers here, whose outputs are computed once for all frames with the same
    observation or goal. `embed` and `embed_goal` give these.

    Args:
        num_features: D, of a view.
        width: of the embedding and of the fused vector.
        num_views: how many an observation has.
    """

    linear: ClassVar = ("embedding",)
    """The layers that read a whole observation, and so can read it in other coordinates as well."""

    def __init__(
        self, num_features: int, width: Annotated[int, Bounds(1, 65_536)] = 512, num_views: int = VIEWS
    ) -> None:
        super().__init__()
        self.width, self.num_views = width, num_views
        self.embedding = nn.Linear(num_views * num_features, width)
        self.fusion = nn.utils.skip_init(nn.Linear, width, width)
        self.goal_fusion = nn.utils.skip_init(nn.Linear, width, width, bias=False)
        whole = nn.Linear(2 * width, width)  # as which both begin
        with torch.no_grad():
            self.fusion.weight.copy_(whole.weight[:, :width])
            self.fusion.bias.copy_(whole.bias)
            self.goal_fusion.weight.copy_(whole.weight[:, width:])

    def embed(self, observation: Tensor) -> Tensor:
        """What the observation adds to the fusion: features ``[..., 4, D]`` to ``[..., width]``."""
        return self.fusion(F.relu(self.embedding(observation.flatten(-2))))

    def embed_goal(self, goal_observation: Tensor) -> Tensor:
        """What the goal adds to the fusion: features ``[..., 4, D]`` to ``[..., width]``."""
        return self.goal_fusion(F.relu(self.embedding(goal_observation.flatten(-2))))

    def fuse(self, embedding: Tensor, goal_embedding: Tensor) -> Tensor:
        """What observation and goal add, ``[..., width]`` each, to the fused vector ``[..., width]``."""
        return F.relu(embedding + goal_embedding)

    def forward(self, observation: Tensor, goal_observation: Tensor) -> Tensor:
        """Features of observation and goal, float32 ``[..., 4, D]`` each, to the fused vector ``[..., width]``."""
        return self.fuse(self.embed(observation), self.embed_goal(goal_observation))
