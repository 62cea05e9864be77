"""The whole network, and its view as TorchRL actor and critic."""

from collections.abc import Sequence

import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor, nn
from torch.distributions import Categorical
from torchrl.modules import ActorValueOperator, ProbabilisticActor

from dirl.models.features import FeatureTable
from dirl.models.heads import SceneLayers
from dirl.models.siamese import SiameseEncoder
from dirl.scenes import ACTIONS


class Network(nn.Module):
    """Siamese encoder, scene-specific layer, policy and value (paper figure 2).

    Weights and biases start uniform in ``+-1/sqrt(fan_in)``, which is both torch's default for linear layers and the
    published code's.

    Args:
        table: the features of the states.
        scenes: the scenes' names; each has its own layer, policy and value. Pass one name to share them.
        width: of every layer.
    """

    def __init__(self, table: FeatureTable, scenes: Sequence[str], width: int = 512) -> None:
        super().__init__()
        self.encoder = SiameseEncoder(table, width)
        self.hidden = SceneLayers(scenes, lambda: nn.Sequential(nn.Linear(width, width), nn.ReLU()))
        self.policy = SceneLayers(scenes, lambda: nn.Linear(width, len(ACTIONS)))
        self.value = SceneLayers(scenes, lambda: nn.Linear(width, 1))

    def forward(self, views: Tensor, goal_views: Tensor, scene: Tensor) -> tuple[Tensor, Tensor]:
        """Logits ``[B, 4]`` and state value ``[B, 1]`` of states seen, int64 ``[B, 4]``, in scenes int64 ``[B]``."""
        hidden = self.hidden(self.encoder(views, goal_views), scene)
        return self.policy(hidden, scene), self.value(hidden, scene)


def actor_critic(network: Network) -> ActorValueOperator:
    """The network as TorchRL's operators: a common trunk to ``hidden``, and two small heads on it.

    The losses are given the heads only, so that the trunk runs once an update for actor and critic together.
    """
    trunk = TensorDictSequential(
        TensorDictModule(network.encoder, ["views", "goal_views"], ["fused"]),
        TensorDictModule(network.hidden, ["fused", "scene"], ["hidden"]),
    )
    actor = ProbabilisticActor(
        TensorDictModule(network.policy, ["hidden", "scene"], ["logits"]),
        in_keys=["logits"],
        distribution_class=Categorical,
        distribution_kwargs={"validate_args": False},
        return_log_prob=True,
    )
    critic = TensorDictModule(network.value, ["hidden", "scene"], ["state_value"])
    return ActorValueOperator(trunk, actor, critic)


def count_parameters(network: nn.Module) -> int:
    """The number of trainable values."""
    return sum(parameter.numel() for parameter in network.parameters() if parameter.requires_grad)


def make_network(
    features: Tensor,
    scenes: Sequence[str],
    *,
    statistics: tuple[Tensor, Tensor] | None = None,
    heads: str = "scene",
    width: int = 512,
    seed: int = 0,
) -> Network:
    """A network with its initial weights, decided by the seed alone.

    Args:
        features: the backbone's output for each state of the world, float32 ``[N, D]``.
        scenes: the names of the world's scenes.
        statistics: mean and deviation to standardise features with, float32 ``[D]`` each; raw features if left out.
        heads: ``scene`` for layers of each scene's own, ``shared`` for one set of them.
        width: of every layer.
        seed: of the initial weights.
    """
    names = {"scene": list(scenes), "shared": ["shared"]}[heads]
    mean, std = statistics or (None, None)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return Network(FeatureTable(features, mean, std), names, width)
