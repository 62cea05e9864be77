"""From a rollout to gradients: what agents that take turns and workers side by side have in common."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import torch
from tensordict import TensorDictBase
from torch.nn.utils import clip_grad_norm_
from torch.optim import Optimizer
from torchrl.envs import EnvBase

from dirl.config.schemas import ObjectiveConfig
from dirl.models import Network, actor_critic
from dirl.objectives import ImitationLoss, bootstrap, clip_each, make_advantages, make_loss
from dirl.training.build import Parts

Gradients = Callable[[TensorDictBase, float], Iterator[TensorDictBase]]
"""A rollout ``[B, T]`` and the share of the training that is left, 1 to 0, to the losses of each update."""


class Update(NamedTuple):
    """What is told of an update."""

    frames: int
    """Walked for it."""
    goal_index: list[int]
    """The goals of the episodes that ended, in the order they ended."""
    steps: list[int]
    """How long these were."""
    values: dict[str, float]
    """Losses."""


def make_gradients(parts: Parts, network: Network) -> Gradients:
    """A function that computes the clipped gradients of a network from rollouts (paper section 3.2).

    It yields once for each update that a rollout is good for, when the network's parameters hold their gradients, and
    the values of the losses with it. The caller then lets an optimiser step.

    Args:
        parts: of the run; its demonstrations are imitated alongside where ``imitation.keep`` says so.
        network: whose gradients; the one of the parts, or a copy.
    """
    config, demos = parts.config, parts.demos
    options = config.reinforcement
    operator = actor_critic(network)
    trunk, critic = operator.module[0], operator.get_value_operator()
    advantages = make_advantages(options.gamma, options.lmbda)
    objective = make_loss(
        config.objective.name,
        operator,
        entropy=options.entropy,
        value=options.value,
        clip=config.objective.clip,
        reduction=options.reduction,
    )
    imitation = ImitationLoss(operator.get_policy_head(), coeff=config.imitation.keep)
    imitates = config.imitation.keep > 0 and len(demos) > 0
    clip = clip_each if config.optimiser.clip_each else clip_grad_norm_

    def losses(batch: TensorDictBase) -> TensorDictBase:
        rows = batch.select(*trunk.in_keys)
        if imitates:
            rows = torch.cat([rows, demos.select(*trunk.in_keys)])
        hidden = trunk(rows)["hidden"]
        result = objective(batch.set("hidden", hidden[: len(batch)]))
        return result.update(imitation(demos.copy().set("hidden", hidden[len(batch) :]))) if imitates else result

    def gradients(batch: TensorDictBase, left: float) -> Iterator[TensorDictBase]:
        objective.entropy_coeff = options.final_entropy + (options.entropy - options.final_entropy) * left
        imitation.coeff = config.imitation.keep * left
        advantages(bootstrap(batch, critic))
        for part in passes(batch.reshape(-1), config.objective):
            result = losses(part)
            network.zero_grad()
            sum(value for key, value in result.items() if key.startswith("loss_")).backward()
            clip(network.parameters(), config.optimiser.max_norm)
            yield result

    return gradients


def passes(batch: TensorDictBase, options: ObjectiveConfig) -> Iterator[TensorDictBase]:
    """The batches of the updates that follow one rollout: all of it, or shuffled shares of it."""
    for _ in range(options.epochs):
        if options.minibatches == 1:
            yield batch
        else:
            yield from (batch[rows] for rows in torch.randperm(len(batch)).chunk(options.minibatches))


def set_learning_rate(optimiser: Optimizer, rate: float) -> None:
    """Give every group of parameters the same learning rate."""
    for group in optimiser.param_groups:
        group["lr"] = rate


def summarise(env: EnvBase, batch: TensorDictBase, losses: TensorDictBase) -> Update:
    """What there is to tell of an update: its rollout ``[B, T]`` and the losses of its last pass."""
    # In the order they ended.
    over = batch["next"].select("goal", "step_count").transpose(0, 1)[batch["next", "done"].squeeze(-1).T]
    values = {key: value.detach().float().reshape(()) for key, value in sorted(losses.items()) if value.numel() == 1}
    return Update(
        frames=batch.numel(),
        goal_index=env.base_env.goal_index[over["goal"]].tolist(),
        steps=over["step_count"].squeeze(-1).tolist(),
        values=dict(zip(values, torch.stack(list(values.values())).tolist(), strict=True)),  # all in one question
    )
