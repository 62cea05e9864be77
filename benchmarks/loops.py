"""The training loops of others that benchmarks/benchmark.py times beside ours, on the same rooms and network.

Each takes the parts of a run and a number of updates, and returns frames per second without the set-up.
"""

import time
from collections.abc import Callable
from functools import partial
from itertools import islice

import gymnasium
import torch
import torch.nn.functional as F
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor, nn
from torch.distributions import Categorical
from torch.nn.utils import clip_grad_norm_
from torchrl.collectors import Collector
from torchrl.data import TensorSpec, Unbounded
from torchrl.envs import Compose, EnvBase, RewardScaling, StepCounter, TransformedEnv
from torchrl.envs.transforms import Transform
from torchrl.modules import ActorValueOperator, ProbabilisticActor
from torchrl.objectives import A2CLoss
from torchrl.objectives.value import GAE

from dirl.envs import NavigationEnv, Reward
from dirl.envs.transforms import VIEWS
from dirl.evaluation import every_start
from dirl.models.heads import SceneLayers
from dirl.scenes import ACTIONS
from dirl.training.build import Parts, build_optimiser


def bare_tensors(parts: Parts, updates: int) -> float:
    """Our loop without TorchRL and TensorDict: the same computations in the same order, from the world's tables.

    What it is faster is what they cost. (A2C, surrounding views, stop at the goal.)
    """
    config, world, network = parts.config, parts.world, parts.network
    options = config.reinforcement
    agents, steps, limit = options.agents_per_scene * len(world.scenes), options.steps, options.max_steps
    optimiser = build_optimiser(parts)
    demos = [parts.demos[key] for key in ("views", "goal_views", "scene")]
    goal_index, start = every_start(world)
    reward, scale = config.reward, config.reward.scale

    def begin() -> tuple[Tensor, Tensor]:
        chosen = torch.randint(len(start), (agents,))
        return start[chosen], goal_index[chosen]

    def views_of(state: Tensor, goal: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        return world.surrounding[state], world.surrounding[world.goals[goal]], world.scene_of[state]

    state, goal = begin()
    age = torch.zeros(agents, dtype=torch.long)
    began = time.perf_counter()
    for update in range(updates):
        left = 1 - update / updates
        for group in optimiser.param_groups:
            group["lr"] = config.optimiser.lr * left
        with network.encoder.remembering():
            seen, actions, rewards, values, next_values, overs = [], [], [], [], [], []
            with torch.no_grad():
                for _ in range(steps):
                    seen.append(views_of(state, goal))
                    logits, value = network(*seen[-1])
                    actions.append(torch.multinomial(logits.softmax(-1), 1).squeeze(-1))
                    after = world.graph[state, actions[-1]]
                    arrived = after == world.goals[goal]
                    earned = torch.where(after == state, reward.collision, reward.step)
                    rewards.append(torch.where(arrived, reward.goal, earned) * scale)
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
                advantage, advantages = torch.zeros(agents), list[Tensor]()
                for t in reversed(range(steps)):
                    delta = rewards[t] + options.gamma * torch.where(overs[t], next_values[t], following) - values[t]
                    advantage = delta + options.gamma * options.lmbda * ~overs[t] * advantage
                    advantages.insert(0, advantage)
                    following = values[t]
            batch = [torch.cat(parts) for parts in zip(*seen, strict=True)]
            gains, targets = torch.cat(advantages), torch.cat(advantages) + torch.cat(values)
            logits, value = network(*(torch.cat(pair) for pair in zip(batch, demos, strict=True)))
            log_probs = logits.log_softmax(-1)
            own = log_probs[: len(gains)]
            taken = own.gather(-1, torch.cat(actions).unsqueeze(-1)).squeeze(-1)
            entropy = -(own.exp() * own).sum(-1).mean()
            loss = -(taken * gains).mean() - options.entropy * left * entropy
            loss = loss + options.value * F.mse_loss(value[: len(gains)].squeeze(-1), targets)
            cloned = F.nll_loss(log_probs[len(gains) :], parts.demos["expert_action"])
            optimiser.zero_grad()
            (loss + config.imitation.keep * left * cloned).backward()
            clip_grad_norm_(network.parameters(), config.optimiser.max_norm)
            optimiser.step()
    return updates * agents * steps / (time.perf_counter() - began)


class Features(Transform):
    """The four views' features of agent and goal as keys, as TorchRL's tutorials would have it, float32 ``[B, 4, D]``.

    Args:
        table: of all states, float32 ``[N, D]``.
        surrounding: the states seen from each state, int64 ``[N, 4]``.
    """

    def __init__(self, table: Tensor, surrounding: Tensor) -> None:
        super().__init__(in_keys=["state", "goal"], out_keys=["observation", "goal_observation"])
        self.register_buffer("table", table)
        self.register_buffer("surrounding", surrounding)

    def _apply_transform(self, state: Tensor) -> Tensor:
        return self.table[self.surrounding[state]]

    def _reset(self, tensordict, tensordict_reset):  # type: ignore[no-untyped-def]
        return self._call(tensordict_reset)

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add both keys."""
        for key in self.out_keys:
            observation_spec[key] = Unbounded((*observation_spec.shape, VIEWS, self.table.shape[1]))
        return observation_spec


class PlainTrunk(nn.Module):
    """The encoder of `dirl.models.SiameseEncoder`, written straight down.

    Args:
        features: of a view, D.
        width: of the embedding and of the fused vector.
    """

    def __init__(self, features: int, width: int) -> None:
        super().__init__()
        self.embedding = nn.Sequential(nn.Flatten(-2), nn.Linear(VIEWS * features, width), nn.ReLU())
        self.fusion = nn.Sequential(nn.Linear(2 * width, width), nn.ReLU())

    def forward(self, observation: Tensor, goal_observation: Tensor) -> Tensor:
        """Features float32 ``[B, 4, D]`` each, to ``[B, width]``."""
        return self.fusion(torch.cat([self.embedding(observation), self.embedding(goal_observation)], -1))


class PlainLayers(SceneLayers):
    """`SceneLayers` for batches of any shape: TorchRL's GAE asks the critic for all steps of all agents at once."""

    def forward(self, rows: Tensor, scene: Tensor) -> Tensor:
        """Rows ``[..., F]`` of scenes int64 ``[...]``, to ``[..., F']``."""
        return super().forward(rows.flatten(0, -2), scene.flatten()).unflatten(0, scene.shape)


def stock_torchrl(parts: Parts, updates: int) -> float:
    """TorchRL as its A2C examples use it: collector, features as keys, GAE and loss with networks of their own passes.

    Its batches and network are ours; there is no imitation in it.
    """
    config, world = parts.config, parts.world
    options, width = config.reinforcement, config.network.width
    agents = options.agents_per_scene * len(world.scenes)
    trunk = TensorDictSequential(
        TensorDictModule(PlainTrunk(world.features.shape[1], width), ["observation", "goal_observation"], ["fused"]),
        TensorDictModule(
            PlainLayers(world.names, lambda: nn.Sequential(nn.Linear(width, width), nn.ReLU())),
            ["fused", "scene"],
            ["hidden"],
        ),
    )
    policy = PlainLayers(world.names, lambda: nn.Linear(width, len(ACTIONS)))
    actor = ProbabilisticActor(
        TensorDictModule(policy, ["hidden", "scene"], ["logits"]),
        in_keys=["logits"],
        distribution_class=Categorical,
        return_log_prob=True,
    )
    value = PlainLayers(world.names, lambda: nn.Linear(width, 1))
    critic = TensorDictModule(value, ["hidden", "scene"], ["state_value"])
    operator = ActorValueOperator(trunk, actor, critic)
    policy_operator, value_operator = operator.get_policy_operator(), operator.get_value_operator()
    gae = GAE(gamma=options.gamma, lmbda=options.lmbda, value_network=value_operator, deactivate_vmap=True)
    loss = A2CLoss(policy_operator, value_operator, entropy_coeff=options.entropy, critic_coeff=options.value)
    optimiser = torch.optim.Adam(loss.parameters(), lr=config.optimiser.lr)

    def make_env() -> EnvBase:
        reward = Reward(config.reward.goal, config.reward.step, config.reward.collision)
        views = Features(parts.network.encoder.table.table, world.surrounding)
        scaled = RewardScaling(loc=0.0, scale=config.reward.scale)
        return TransformedEnv(
            NavigationEnv(world, agents, reward=reward), Compose(StepCounter(options.max_steps), scaled, views)
        )

    collector = Collector(
        make_env,
        policy_operator,
        frames_per_batch=agents * options.steps,
        total_frames=agents * options.steps * (updates + 1),
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
        clip_grad_norm_(loss.parameters(), config.optimiser.max_norm)
        optimiser.step()
    collector.shutdown()
    return updates * agents * options.steps / (time.perf_counter() - began)


def stable_baselines3(parts: Parts, updates: int) -> float:
    """Stable-Baselines3's A2C on ``dirl/Navigation-v0``, as many steps an update as ours.

    Its network is ours with one head for all scenes. There is no imitation in it. Of agents it has 16 a scene at
    most: each holds its own tables, and more did not make it faster.
    """
    from stable_baselines3 import A2C
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
    from stable_baselines3.common.vec_env import DummyVecEnv

    config, world = parts.config, parts.world
    options, width = config.reinforcement, config.network.width

    class Trunk(BaseFeaturesExtractor):
        def __init__(self, space: gymnasium.spaces.Dict) -> None:
            super().__init__(space, width)
            self.trunk = PlainTrunk(world.features.shape[1], width)
            self.hidden = nn.Sequential(nn.Linear(width, width), nn.ReLU())

        def forward(self, seen: dict[str, Tensor]) -> Tensor:
            return self.hidden(self.trunk(seen["features"], seen["goal_features"]))

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
        n_steps=options.steps,
        gamma=options.gamma,
        gae_lambda=options.lmbda,
        policy_kwargs={"features_extractor_class": Trunk, "net_arch": []},
        device="cpu",
    )
    clock, frames = Clock(), len(make) * options.steps
    model.learn((updates + 1) * frames, callback=clock)
    first, *_, last = islice(clock.times, updates + 1)
    return updates * frames / (last - first)
