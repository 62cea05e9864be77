"""Trials of an expert and of losses before a training, so that one's own are not refused in the middle of it."""

from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import nn
from torchrl.envs.utils import ExplorationType, set_exploration_type

from dirl.config.schemas import TrainConfig
from dirl.config.user_code import tried
from dirl.models import caching
from dirl.scenes import ACTIONS, World
from dirl.training.losses import Losses
from dirl.training.objectives import bootstrap, make_advantages
from dirl.training.rollout import INTERMEDIATE
from dirl.training.state import random_state, restore_random_state

ASKED = 1000
"""States in which an expert is tried."""


def try_losses(config: TrainConfig, policy: Any, losses: Losses, agents: TensorDictBase) -> None:
    """Compute each loss once, on a made-up step of two agents; nothing but the losses is changed by it.

    Args:
        config: of the training.
        policy: see `dirl.models.ActorCritic`.
        losses: made for this trial: what they hold, as a replay buffer does, is not that of the training.
        agents: where they stand before the first step, ``[B]``.

    Raises:
        ConfigError: a loss fails, or does not give what it should, see docs/howto/extend.md.
    """
    operator, options = policy.operator(), config.reinforcement
    advantages = make_advantages(options.gamma, options.lmbda)
    every, before = losses.losses, random_state(agents.device)
    for name, loss in every.items():
        losses.losses = {name: loss}
        with caching(policy), tried(f"losses.{name}", loss.module, ", on a rollout"):
            rollout = _stay(operator, agents[:2])
            batch = advantages(bootstrap(losses.rewarded(rollout), operator.get_value_operator()))
            for key, value in losses(batch if losses.recurrent else batch.reshape(-1), 1.0).items():
                if key.startswith("loss_") and value.shape:
                    raise ValueError(f"gives {key} {list(value.shape)}; expected one number, []")
    restore_random_state(before)


def try_expert(expert: nn.Module, world: World) -> None:
    """Ask an expert the way from some states to a goal.

    Raises:
        ConfigError: it fails, or does not give actions.
    """
    state = torch.arange(min(len(world), ASKED), device=world.device)
    asked = TensorDict({"state": state, "goal": world.goals[:1].expand(len(state))}, batch_size=[len(state)])
    before, expected = random_state(world.device), f"{torch.int64} {[len(state)]}"
    with tried("expert", expert, f", on {len(state)} states"):
        action = expert(asked)["expert_action"]
        if (found := f"{action.dtype} {list(action.shape)}") != expected:
            raise ValueError(f"gives expert_action {found}; expected {expected}")
        if not -1 <= int(action.min()) <= int(action.max()) < len(ACTIONS):
            raise ValueError(f"gives actions from {int(action.min())} to {int(action.max())}; expected -1 to 3")
    restore_random_state(before)


@torch.no_grad()
def _stay(operator: Any, agents: TensorDictBase) -> TensorDictBase:
    """A rollout of one step, ``[B, 1]``, whose actions have no effect and no reward."""
    with set_exploration_type(ExplorationType.RANDOM):
        step = operator(agents.clone()).exclude(*INTERMEDIATE)
    after = agents.clone().set("reward", torch.zeros_like(agents["done"], dtype=torch.float32))
    rollout = step.set("next", after.update(step.get("next", {}))).unsqueeze(1)
    rollout.names = [*rollout.names[:-1], "time"]
    return rollout
