"""The training loops of others that benchmarks/benchmark.py times beside ours, on the same rooms and network.

Each takes the configuration of a run and a number of updates, and returns frames per second without the set-up.
"""

import time
from collections.abc import Callable
from functools import partial
from itertools import islice
from typing import Any

import gymnasium
import torch
import torch.nn.functional as F
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor, nn
from torch.distributions import Categorical
from torch.nn.utils import clip_grad_norm_
from torchrl.collectors import Collector
from torchrl.envs import Compose, EnvBase, RewardScaling, StepCounter, TransformedEnv
from torchrl.modules import ActorValueOperator, ProbabilisticActor
from torchrl.objectives import A2CLoss
from torchrl.objectives.value import GAE

from dirl.config.schemas import ReinforcementConfig, TrainConfig
from dirl.envs import NavigationEnv, Reward, SurroundingViews, ViewFeatures
from dirl.evaluation.episodes import every_start
from dirl.models import SiameseEncoder, caching
from dirl.models.build import build_policy, feature_table
from dirl.training.build import build_demonstrations, build_observation, build_optimiser, build_world
from dirl.training.load import learning_policy
from dirl.training.losses import set_learning_rate


def bare_tensors(config: TrainConfig, updates: int) -> float:
    """Our loop without TorchRL and TensorDict: the same computations in the same order, from the world's tables.

    What it is faster is what they cost. (A2C, surrounding views, stop at the goal, cached embeddings, no memory.)
    """
    options, world = config.reinforcement, build_world(config)
    observation = build_observation(config, world)
    policy: Any = learning_policy(config, world, observation)
    rows: Any = build_demonstrations(config, world, observation)
    agents, steps, limit = options.agents_per_scene * len(world.scenes), options.n_steps, options.max_steps
    optimiser = build_optimiser(config, policy)
    network, demos = partial(logits_and_value, policy), [rows[key] for key in ("view_ids", "goal_view_ids", "scene")]
    goal_index, start = every_start(world)
    reward = config.reward

    def begin() -> tuple[Tensor, Tensor]:
        chosen = torch.randint(len(start), (agents,))
        return start[chosen], goal_index[chosen]

    def views_of(state: Tensor, goal: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        return world.surrounding[state], world.surrounding[world.goals[goal]], world.scene_of[state]

    (state, goal), age = begin(), torch.zeros(agents, dtype=torch.long)
    began = time.perf_counter()
    for update in range(updates):
        left = 1 - update / updates
        set_learning_rate(optimiser, optimiser.defaults["lr"] * left)
        with caching(policy):
            seen, actions, rewards, values, next_values, overs = [], [], [], [], [], []
            with torch.no_grad():
                for _ in range(steps):
                    seen.append(views_of(state, goal))
                    logits, value = network(*seen[-1])
                    actions.append(torch.multinomial(logits.softmax(-1), 1).squeeze(-1))
                    after = world.graph[state, actions[-1]]
                    arrived = after == world.goals[goal]
                    earned = torch.where(after == state, reward.collision, reward.step)
                    rewards.append(torch.where(arrived, reward.goal, earned) * reward.scale)
                    values.append(value.squeeze(-1))
                    age += 1
                    over = arrived | (age >= limit)
                    cut = over & ~arrived
                    next_value = torch.zeros(agents)
                    if cut.any():
                        next_value[cut] = network(*views_of(after[cut], goal[cut]))[1].squeeze(-1)
                    next_values.append(next_value)
                    overs.append(over)
                    fresh, fresh_goal = begin()
                    state, goal = torch.where(over, fresh, after), torch.where(over, fresh_goal, goal)
                    age[over] = 0
                following = network(*views_of(state, goal))[1].squeeze(-1)
                gains = advantages(options, rewards, overs, values, next_values, following)
            batch = [torch.cat(parts) for parts in zip(*seen, strict=True)]
            logits, value = network(*(torch.cat(pair) for pair in zip(batch, demos, strict=True)))
            taken, known = torch.cat(actions), torch.cat(values)
            loss = actor_critic_loss(logits[: len(gains)], value[: len(gains)], taken, gains, known, options, left)
            cloned = F.cross_entropy(logits[len(gains) :], rows["expert_action"])
            optimiser.zero_grad()
            (loss + config.imitation.bc_coef(left) * cloned).backward()
            clip_grad_norm_(policy.parameters(), options.max_grad_norm)
            optimiser.step()
    return updates * agents * steps / (time.perf_counter() - began)


def logits_and_value(policy: Any, view_ids: Tensor, goal_view_ids: Tensor, scene: Tensor) -> tuple[Tensor, Tensor]:
    """What an `ActorCritic` makes of ``[B, 4]`` view ids in scenes ``[B]``, without a tensordict."""
    hidden = policy.heads.trunk(policy.cached(view_ids, goal_view_ids), scene)
    return policy.heads.policy(hidden, scene), policy.heads.value(hidden, scene)


def advantages(
    options: ReinforcementConfig,
    rewards: list[Tensor],
    overs: list[Tensor],
    values: list[Tensor],
    next_values: list[Tensor],
    following: Tensor,
) -> Tensor:
    """Generalised advantage estimation, float32 ``[T * B]``, of T steps of B agents: ``[B]`` for each step.

    Args:
        options: discounts.
        rewards: of each step.
        overs: whether the episode ended, bool.
        values: of the states before each step.
        next_values: of the states behind the last steps of episodes that were cut off, else zero.
        following: the values of the states behind the last step.
    """
    advantage, found = torch.zeros_like(following), list[Tensor]()
    for t in reversed(range(len(rewards))):
        delta = rewards[t] + options.gamma * torch.where(overs[t], next_values[t], following) - values[t]
        advantage = delta + options.gamma * options.lmbda * ~overs[t] * advantage
        found.insert(0, advantage)
        following = values[t]
    return torch.cat(found)


def actor_critic_loss(
    logits: Tensor,
    value: Tensor,
    taken: Tensor,
    gains: Tensor,
    known: Tensor,
    options: ReinforcementConfig,
    left: float,
) -> Tensor:
    """The A2C loss of steps, ``[T * B]`` each: logits and values with gradients, actions, advantages, old values."""
    log_probs = logits.log_softmax(-1)
    of_taken = log_probs.gather(-1, taken.unsqueeze(-1)).squeeze(-1)
    entropy = -(log_probs.exp() * log_probs).sum(-1).mean()
    loss = -(of_taken * gains).mean() - options.entropy_coef(left) * entropy
    return loss + options.critic_coef * F.mse_loss(value.squeeze(-1), gains + known)


class AnyBatch(nn.Module):
    """Scene-specific layers for batches of any shape: TorchRL's GAE asks the critic for all steps of all agents.

    Args:
        layers: of rows ``[B, F]`` and scenes ``[B]``, see `dirl.models.heads`.
    """

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
