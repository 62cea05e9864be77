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
    A new episode is drawn for every agent at every step, and used where the old one ended. ``step_and_maybe_reset``
    would ask first whether there is any, and a GPU that is asked stands still.

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
            step = env.step(policy(agents).exclude(*INTERMEDIATE))
            taken.append(step)
            fresh = env.reset()
            after = step["next"].select(*fresh.keys())
            agents = fresh.where(after["done"].squeeze(-1), after)
    batch = TensorDict.stack(taken, -1)
    batch.names = [*batch.names[:-1], "time"]
    return batch, agents
