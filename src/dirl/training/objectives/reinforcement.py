"""Advantages of rollouts, which TorchRL's actor-critic losses read (paper section 3.2)."""

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.objectives.value import GAE


def make_advantages(gamma: float, lmbda: float) -> GAE:
    """TorchRL's generalised advantage estimation over values that are already in the batch.

    With ``lmbda=1`` it is the paper's n-step return minus the value (equations 5 and 6).
    """
    return GAE(gamma=gamma, lmbda=lmbda, value_network=None, deactivate_vmap=True)


@torch.no_grad()
def bootstrap(batch: TensorDictBase, critic: TensorDictModuleBase) -> TensorDictBase:
    """Write the value of each step's next state, ``("next", "state_value")`` float32 ``[B, T, 1]``.

    Within an episode it is the value of the following step, known from the rollout. The critic is only evaluated
    for the states after the last step and where an episode was truncated.

    Args:
        batch: ``[B, T]`` with ``state_value``.
        critic: the whole value operator, from views to ``state_value``.
    """
    values = torch.zeros_like(batch["state_value"])
    values[:, :-1] = batch["state_value"][:, 1:]
    unknown = batch["next", "truncated"].squeeze(-1).clone()
    unknown[:, -1] = True
    values[unknown] = critic(batch["next"].select(*critic.in_keys)[unknown])["state_value"]
    batch["next", "state_value"] = values
    return batch
