"""Advantages of rollouts, which TorchRL's actor-critic losses read (paper section 3.2)."""

from collections.abc import Callable

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.objectives.value import GAE
from torchrl.objectives.value.functional import generalized_advantage_estimate


def make_advantages(gamma: float | Tensor, lmbda: float | Tensor) -> Callable[[TensorDictBase], TensorDictBase]:
    """TorchRL's generalised advantage estimation over values that are already in the batch.

    With ``lmbda=1`` it is the paper's n-step return minus the value (equations 5 and 6). Tensors, ``[R, 1, 1, 1]``, are
    those of the runs of a stack, whose batches are ``[R, B, T]``.
    """
    if isinstance(gamma, Tensor):
        return lambda batch: _advantages_of_runs(batch, gamma, lmbda)
    return GAE(gamma=gamma, lmbda=lmbda, value_network=None, deactivate_vmap=True)


def _advantages_of_runs(batch: TensorDictBase, gamma: Tensor, lmbda: float | Tensor) -> TensorDictBase:
    """The same step by step: the module takes one ``gamma``, and its shapes depend on where episodes end."""
    after = batch["next"]
    given = (batch["state_value"], after["state_value"], after["reward"], after["done"], after["terminated"])
    advantage, target = generalized_advantage_estimate(gamma, lmbda, *given)
    return batch.update({"advantage": advantage, "value_target": target})


@torch.no_grad()
def bootstrap(batch: TensorDictBase, critic: TensorDictModuleBase) -> TensorDictBase:
    """Write the value of each step's next state, ``("next", "state_value")`` float32 ``[B, T, 1]``.

    Within an episode it is the value of the following step, known from the rollout. The critic is only evaluated
    for the states after the last step and where an episode was truncated.

    Args:
        batch: ``[B, T]`` with ``state_value``.
        critic: the whole value operator, from views to ``state_value``.
    """
    if getattr(critic, "fixed_shapes", False):
        return _bootstrap_all(batch, critic)
    values = torch.zeros_like(batch["state_value"])
    values[:, :-1] = batch["state_value"][:, 1:]
    unknown = batch["next", "truncated"].squeeze(-1).clone()
    unknown[:, -1] = True
    values[unknown] = critic(batch["next"].select(*critic.in_keys)[unknown])["state_value"]
    batch["next", "state_value"] = values
    return batch


def _bootstrap_all(batch: TensorDictBase, critic: TensorDictModuleBase) -> TensorDictBase:
    """The same for ``[R, B, T]`` by two values of each agent: an episode is truncated at most once in a rollout."""
    truncated = batch["next", "truncated"]
    first = truncated.squeeze(-1).int().argmax(-1)
    last = torch.full_like(first, batch.shape[-1] - 1)
    ends = batch["next"].select(*critic.in_keys).gather(batch.ndim - 1, torch.stack([first, last], -1))
    at_first, at_last = critic(ends)["state_value"].split(1, -2)
    following = torch.cat([batch["state_value"][..., 1:, :], at_last], -2)
    batch["next", "state_value"] = torch.where(truncated, at_first, following)
    return batch
