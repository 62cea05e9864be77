"""Collecting rollouts: agents continue from their present states."""

from typing import NamedTuple

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

# What the policy computes on its way to an action; the losses compute it again, with gradients.
INTERMEDIATE = ("observation", "goal_observation", "fused", "memory", "hidden", "logits")


@torch.no_grad()
def collect(
    env: EnvBase, policy: TensorDictModuleBase, agents: TensorDictBase, n_steps: int
) -> tuple[TensorDictBase, TensorDictBase]:
    """Let every agent take some steps.

    This is what TorchRL's ``Collector`` does, without its state: the agents' states between two calls are a
    tensordict that the caller keeps, and that a checkpoint can hold. (A ``Collector`` can only restart from a reset.)
    A new episode is sampled for every agent at every step, and used where the old one ended: ``step_and_maybe_reset``
    would first read whether any has ended, a host-device synchronisation.

    Args:
        env: batched, B agents.
        policy: writes ``action``.
        agents: their present states, ``[B]``; at first ``env.reset()``.
        n_steps: how many each takes, T.

    Returns:
        The steps, ``[B, T]``, and the agents' present states, ``[B]``; those whose episode ended start a new one.
    """
    taken = []
    # Without this TorchRL's actors take the most probable action.
    with set_exploration_type(ExplorationType.RANDOM):
        for _ in range(n_steps):
            step = env.step(policy(agents).exclude(*INTERMEDIATE))
            taken.append(step)
            fresh = env.reset()
            after = step["next"].select(*fresh.keys())
            agents = fresh.where(after["done"].squeeze(-1), after)
    batch = TensorDict.stack(taken, -1)
    batch.names = [*batch.names[:-1], "time"]
    return batch, agents


class Update(NamedTuple):
    """What is reported of an update."""

    frames: int
    """Of its rollout."""
    goal_index: list[int]
    """The goals of the episodes that ended, in the order they ended."""
    steps: list[int]
    """How long these were."""
    values: dict[str, float]
    """Losses, and what describes the update beside them."""


class Report(NamedTuple):
    """What R runs report of an update, where it was computed: a graph overwrites it, and to read it is to wait."""

    names: list[str]
    """Of the values."""
    frames: int
    """F, of each run."""
    numbers: Tensor
    """K values of each run; then which of its F steps end an episode, their goals and lengths, ``[R, K + 3F]``."""

    def read(self) -> list[Update]:
        """Return the report of each run."""
        values, *over = self.numbers.cpu().split([len(self.names), *[self.frames] * 3], 1)
        reports = []
        for own, done, goal, steps in zip(values.tolist(), *(part.long().numpy() for part in over), strict=True):
            ended = done.nonzero()
            named = dict(zip(self.names, own, strict=True))
            reports.append(Update(self.frames, goal[ended].tolist(), steps[ended].tolist(), named))
        return reports


def report(env: EnvBase, batch: TensorDictBase, losses: TensorDictBase) -> Report:
    """Return the report of an update of R runs, from their rollouts ``[R, B, T]`` and its losses, ``[R]``.

    Those of one run may be ``[B, T]`` and ``[]``. With them comes the fraction of the variance of the returns that the
    critic explains: 1 is a perfect one, 0 one that says the same of every state.
    """
    if batch.batch_dims == 2:
        batch, losses = batch.unsqueeze(0), losses.unsqueeze(0)
    means = {key: value.float() for key, value in sorted(losses.items()) if value.ndim == 1}
    target, value = batch["value_target"].float().flatten(1), batch["state_value"].float().flatten(1)
    means["explained_variance"] = 1 - (target - value).var(1) / target.var(1)
    after = batch["next"]
    ends = [after["done"].squeeze(-1), env.base_env.goal_index[after["goal"]], after["step_count"].squeeze(-1)]
    over = [end.mT.flatten(1).float() for end in ends]  # in the order they ended; whole numbers, which stay exact
    return Report([*means], over[0].shape[1], torch.cat([torch.stack([*means.values()], 1), *over], 1))
