"""Stock TorchRL's training loop, which recipes/benchmark.py times beside ours, on the same rooms and network."""

import time

import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch.distributions import Categorical
from torch.nn.utils import clip_grad_norm_
from torchrl.collectors import Collector
from torchrl.envs import Compose, EnvBase, RewardScaling, StepCounter, TransformedEnv
from torchrl.modules import ActorValueOperator, ProbabilisticActor
from torchrl.objectives import A2CLoss
from torchrl.objectives.value import GAE

from dirl.config.components import make
from dirl.config.schemas import TrainConfig
from dirl.envs import NavigationEnv, Reward, SurroundingViews, ViewFeatures
from dirl.models.build import build_policy, feature_table
from dirl.training.build import build_world
from dirl.training.objectives import trained_parameters


def stock_torchrl(config: TrainConfig, updates: int) -> float:
    """Train as TorchRL's A2C examples do: collector, features as keys, GAE and loss with forward passes of their own.

    Its batches and network are ours; there is no imitation in it. Returns frames per second of so many updates, without
    the set-up.
    """
    options, world = config.reinforcement, build_world(config)
    agents, table = options.agents_per_scene * len(world.scenes), feature_table(config, world)
    network = build_policy(config, table, world.names, world=world)
    trunk = TensorDictSequential(
        TensorDictModule(network.encoder, ["observation", "goal_observation"], ["fused"]),
        TensorDictModule(network.heads.trunk, ["fused", "scene"], ["hidden"]),
    )
    actor = ProbabilisticActor(
        TensorDictModule(network.heads.policy, ["hidden", "scene"], ["logits"]),
        in_keys=["logits"],
        distribution_class=Categorical,
        return_log_prob=True,
    )
    critic = TensorDictModule(network.heads.value, ["hidden", "scene"], ["state_value"])
    operator = ActorValueOperator(trunk, actor, critic)
    policy, value = operator.get_policy_operator(), operator.get_value_operator()
    gae = GAE(gamma=options.gamma, lmbda=options.lmbda, value_network=value, deactivate_vmap=True)
    loss = A2CLoss(policy, value, entropy_coeff=options.entropy_coef.start, critic_coeff=options.critic_coef)
    optimiser = make("optimiser", config.optimiser, config.trust, params=trained_parameters(loss))

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
