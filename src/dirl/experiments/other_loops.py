"""The training loops of others that recipes/benchmark.py times beside ours, on the same rooms and network.

Each takes the configuration of a run and a number of updates, and returns frames per second without the set-up.
"""

import time
from collections.abc import Callable
from functools import partial
from itertools import islice
from typing import Any

import gymnasium
import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor, nn
from torch.distributions import Categorical
from torch.nn.utils import clip_grad_norm_
from torchrl.collectors import Collector
from torchrl.envs import Compose, EnvBase, RewardScaling, StepCounter, TransformedEnv
from torchrl.modules import ActorValueOperator, ProbabilisticActor
from torchrl.objectives import A2CLoss
from torchrl.objectives.value import GAE

from dirl.config.schemas import TrainConfig
from dirl.envs import NavigationEnv, Reward, SurroundingViews, ViewFeatures
from dirl.models import SiameseEncoder
from dirl.models.build import build_policy, feature_table
from dirl.training.build import build_optimiser, build_world


class AnyBatch(nn.Module):
    """Scene-specific layers, see `dirl.models.policy`, for batches of any shape, as TorchRL's GAE asks the critic."""

    def __init__(self, layers: nn.Module) -> None:
        super().__init__()
        self.layers = layers

    def forward(self, rows: Tensor, scene: Tensor) -> Tensor:
        """Rows ``[..., F]`` of scenes int64 ``[...]``, to ``[..., F']``."""
        return self.layers(rows.flatten(0, -2), scene.flatten()).unflatten(0, scene.shape)


def stock_torchrl(config: TrainConfig, updates: int) -> float:
    """TorchRL as its A2C examples use it: collector, features as keys, GAE and loss with networks of their own passes.

    Its batches and network are ours; there is no imitation in it.
    """
    options, world = config.reinforcement, build_world(config)
    agents, table = options.agents_per_scene * len(world.scenes), feature_table(config, world)
    network: Any = build_policy(config, table, world.names, world=world)
    trunk = TensorDictSequential(
        TensorDictModule(network.encoder, ["observation", "goal_observation"], ["fused"]),
        TensorDictModule(AnyBatch(network.heads.trunk), ["fused", "scene"], ["hidden"]),
    )
    actor = ProbabilisticActor(
        TensorDictModule(AnyBatch(network.heads.policy), ["hidden", "scene"], ["logits"]),
        in_keys=["logits"],
        distribution_class=Categorical,
        return_log_prob=True,
    )
    critic = TensorDictModule(AnyBatch(network.heads.value), ["hidden", "scene"], ["state_value"])
    operator = ActorValueOperator(trunk, actor, critic)
    policy, value = operator.get_policy_operator(), operator.get_value_operator()
    gae = GAE(gamma=options.gamma, lmbda=options.lmbda, value_network=value, deactivate_vmap=True)
    loss = A2CLoss(policy, value, entropy_coeff=options.entropy_coef.start, critic_coeff=options.critic_coef)
    optimiser = build_optimiser(config, loss)

    def make_env() -> EnvBase:
        reward = Reward(config.reward.goal, config.reward.step, config.reward.collision)
        scaled = RewardScaling(loc=0.0, scale=config.reward.scale)
        seen = SurroundingViews(world), ViewFeatures(table.known)
        transforms = Compose(StepCounter(options.max_steps), scaled, *seen)
        return TransformedEnv(NavigationEnv(world, agents, reward=reward), transforms)

    collector = Collector(
        make_env,
        policy,
        frames_per_batch=agents * options.n_steps,
        total_frames=agents * options.n_steps * (updates + 1),
        auto_register_policy_transforms=False,
    )
    began = 0.0
    for update, batch in enumerate(collector):
        if update == 1:  # the first one warms up
            began = time.perf_counter()
        with torch.no_grad():
            gae(batch)
        result = loss(batch.reshape(-1))
        optimiser.zero_grad()
        sum(value for key, value in result.items() if key.startswith("loss_")).backward()
        clip_grad_norm_(loss.parameters(), options.max_grad_norm)
        optimiser.step()
    collector.shutdown()
    return updates * agents * options.n_steps / (time.perf_counter() - began)


def stable_baselines3(config: TrainConfig, updates: int) -> float:
    """Stable-Baselines3's A2C on ``dirl/Navigation-v0``, as many steps an update as ours.

    Its network is ours with one head for all scenes. There is no imitation in it. Of agents it has 16 a scene at
    most: each holds its own tables, and more did not make it faster.
    """
    from stable_baselines3 import A2C
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
    from stable_baselines3.common.vec_env import DummyVecEnv

    options, world = config.reinforcement, build_world(config)
    width, hidden = config.encoder["width"], config.heads["width"]

    class Trunk(BaseFeaturesExtractor):
        def __init__(self, space: gymnasium.spaces.Dict) -> None:
            super().__init__(space, hidden)
            self.encoder = SiameseEncoder(world.features.shape[1], width)
            self.hidden = nn.Sequential(nn.Linear(width, hidden), nn.ReLU())

        def forward(self, seen: dict[str, Tensor]) -> Tensor:
            return self.hidden(self.encoder(seen["features"], seen["goal_features"]))

    class Clock(BaseCallback):
        """When each rollout ended."""

        def __init__(self) -> None:
            super().__init__()
            self.times: list[float] = []

        def _on_step(self) -> bool:
            return True

        def _on_rollout_end(self) -> None:
            self.times.append(time.perf_counter())

    make: list[Callable[[], gymnasium.Env]] = [
        partial(gymnasium.make, "dirl/Navigation-v0", scene=scene.name, max_episode_steps=options.max_steps)
        for scene in world.scenes
        for _ in range(min(options.agents_per_scene, 16))
    ]
    model = A2C(
        "MultiInputPolicy",
        DummyVecEnv(make),
        n_steps=options.n_steps,
        gamma=options.gamma,
        gae_lambda=options.lmbda,
        policy_kwargs={"features_extractor_class": Trunk, "net_arch": []},
        device="cpu",
    )
    clock, frames = Clock(), len(make) * options.n_steps
    model.learn((updates + 1) * frames, callback=clock)
    first, *_, last = islice(clock.times, updates + 1)
    return updates * frames / (last - first)
