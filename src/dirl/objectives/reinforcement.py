"""Advantage actor-critic and PPO: TorchRL's losses on the heads of the network (paper section 3.2)."""

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.modules import ActorValueOperator
from torchrl.objectives import A2CLoss, ClipPPOLoss, LossModule
from torchrl.objectives.value import GAE


def make_advantages(gamma: float, lmbda: float) -> GAE:
    """TorchRL's generalised advantage estimation over values that are already in the batch.

    With ``lmbda=1`` it is the paper's n-step return minus the value (equations 5 and 6).
    """
    return GAE(gamma=gamma, lmbda=lmbda, value_network=None, deactivate_vmap=True)


@torch.no_grad()
def bootstrap(batch: TensorDictBase, critic: TensorDictModuleBase) -> TensorDictBase:
    """Write the value of each step's next state, ``("next", "state_value")`` float32 ``[B, T, 1]``.

    Within an episode it is the value of the following step, known from the rollout. The critic is asked only for the
    states behind the last step and where an episode was cut off.

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


def make_loss(
    objective: str,
    network: ActorValueOperator,
    *,
    entropy: float,
    value: float,
    clip: float = 0.2,
    reduction: str = "mean",
) -> LossModule:
    """The loss over the heads; the trunk must have written ``hidden``.

    Args:
        objective: ``a2c`` or ``ppo``.
        network: the actor-critic whose heads are trained.
        entropy: weight of the entropy bonus, beta of paper equation 7.
        value: weight of the squared error of the value.
        clip: how far PPO's ratio may go from one.
        reduction: ``mean`` or ``sum`` over the frames of a batch.

    Raises:
        ValueError: there is no such objective.
    """
    heads = network.get_policy_head(), network.get_value_head()
    common = {
        "entropy_coeff": entropy,
        "critic_coeff": value,
        "loss_critic_type": "l2",
        "functional": False,
        "reduction": reduction,
    }
    if objective == "a2c":
        return A2CLoss(*heads, **common)
    if objective == "ppo":
        return ClipPPOLoss(*heads, clip_epsilon=clip, **common)
    raise ValueError(f"there is no objective '{objective}'; choose a2c or ppo")
