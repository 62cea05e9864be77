"""Collecting experience: agents walk on from where they stand."""

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

# What the policy leaves behind on its way to an action; the losses compute it again, with gradients.
INTERMEDIATE = ("fused", "hidden", "logits")


@torch.no_grad()
def collect(
    env: EnvBase, policy: TensorDictModuleBase, agents: TensorDictBase, steps: int
) -> tuple[TensorDictBase, TensorDictBase]:
    """Let every agent take some steps.

    This is what TorchRL's ``Collector`` does, without its state: where the agents stand between two calls is a
    tensordict in the caller's hand, which a checkpoint can hold. (A ``Collector`` can only start again from a reset.)

    Args:
        env: batched, B agents.
        policy: writes ``action``.
        agents: where they stand, ``[B]``; at first ``env.reset()``.
        steps: how many each takes, T.

    Returns:
        The steps, ``[B, T]``, and where the agents stand now, ``[B]``; those whose episode ended start a new one.
    """
    taken = []
    # Without this TorchRL's actors take the most probable action.
    with set_exploration_type(ExplorationType.RANDOM):
        for _ in range(steps):
            step, agents = env.step_and_maybe_reset(policy(agents).exclude(*INTERMEDIATE))
            taken.append(step)
    batch = TensorDict.stack(taken, -1)
    batch.names = [*batch.names[:-1], "time"]
    return batch, agents
