"""The whole network, and its view as TorchRL actor and critic."""

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torch import Tensor, nn
from torch.distributions import Categorical
from torchrl.modules import ActorValueOperator, ProbabilisticActor

from dirl.models.features import FeatureTable
from dirl.models.heads import SceneHeads, SceneLayers
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
        self.policy = SceneHeads(scenes, width, len(ACTIONS))
        self.value = SceneHeads(scenes, width, 1)

    def forward(self, views: Tensor, goal_views: Tensor, scene: Tensor) -> tuple[Tensor, Tensor]:
        """Logits ``[B, 4]`` and state value ``[B, 1]`` of states seen, int64 ``[B, 4]``, in scenes int64 ``[B]``."""
        hidden = self.hidden(self.encoder(views, goal_views), scene)
        return self.policy(hidden, scene), self.value(hidden, scene)

    def weights_on_features(self) -> dict[str, Tensor]:
        """The state_dict that the network would have without principal axes."""
        state = self.state_dict()
        if state.pop("encoder.axes.table", None) is not None:
            state["encoder.embedding.weight"] = self.encoder.weight_on_features()
        return state


class KeyedModule(TensorDictModuleBase):
    """A module that reads its arguments from a tensordict and writes its one result there.

    Each call of tensordict 0.14's own ``TensorDictModule`` searches the disk for pandas, a third of a rollout's time.

    Args:
        module: takes one tensor for each of ``in_keys``.
        in_keys: what it reads.
        out_key: what it writes.
    """

    def __init__(self, module: nn.Module, in_keys: Sequence[str], out_key: str) -> None:
        super().__init__()
        self.module = module
        self.in_keys = list(in_keys)
        self.out_keys = [out_key]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Call the module."""
        result = self.module(*(tensordict.get(key) for key in self.in_keys))
        return tensordict.set(self.out_keys[0], result)


def actor_critic(network: Network) -> ActorValueOperator:
    """The network as TorchRL's operators: a common trunk to ``hidden``, and two small heads on it.

    The losses are given the heads only, so that the trunk runs once an update for actor and critic together.
    """
    trunk = TensorDictSequential(
        KeyedModule(network.encoder, ["views", "goal_views"], "fused"),
        KeyedModule(network.hidden, ["fused", "scene"], "hidden"),
    )
    actor = ProbabilisticActor(
        KeyedModule(network.policy, ["hidden", "scene"], "logits"),
        in_keys=["logits"],
        distribution_class=Categorical,
        distribution_kwargs={"validate_args": False},
        return_log_prob=True,
    )
    return ActorValueOperator(trunk, actor, KeyedModule(network.value, ["hidden", "scene"], "state_value"))


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
