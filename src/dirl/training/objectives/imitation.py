"""Behaviour cloning as TorchRL losses (paper section 3.3)."""

from dataclasses import dataclass
from typing import Any

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from tensordict.nn import ProbabilisticTensorDictSequential, dispatch
from torch import Tensor
from torch.distributions import Categorical
from torchrl.objectives import LossModule


class ImitationLoss(LossModule):
    """Cross-entropy between the expert's action and the actor's distribution (paper equation 12).

    TorchRL 0.14's own ``BCLoss`` fails for actors over discrete actions.

    Args:
        actor: anything with ``get_dist``, as ``ProbabilisticActor`` has.
        reduction: ``mean``, ``sum`` or ``none``.

    Returns of ``forward``: ``loss_imitation`` (scalar) and ``accuracy``, the fraction of rows in which the most
    probable action is the expert's. In keys are the actor's and ``expert_action``, int64 ``[B]``.
    """

    @dataclass
    class _AcceptedKeys:
        expert_action: NestedKey = "expert_action"

    default_keys: Any = _AcceptedKeys
    tensor_keys: Any
    out_keys = ("loss_imitation", "accuracy")
    functional = False

    def __init__(self, actor: ProbabilisticTensorDictSequential, *, reduction: str = "mean") -> None:
        super().__init__()
        self.actor_network = actor
        self.reduction = reduction

    @property
    def in_keys(self) -> list[NestedKey]:
        """What the loss reads."""
        return [*vars(self.tensor_keys).values(), *self.actor_network.in_keys]

    def _forward_value_estimator_keys(self, **_: object) -> None:
        """There is no value estimator."""

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The loss of a batch of demonstrations, see the class."""
        dist = self.actor_network.get_dist(tensordict.select(*self.actor_network.in_keys))
        log_chance, right = self._compare(dist, tensordict.get(self.in_keys[0]))
        loss = self._reduce_loss(-log_chance, tensordict)
        return TensorDict({"loss_imitation": loss, "accuracy": self._reduce_loss(right.float(), tensordict)})

    def _compare(self, dist: Categorical, expert: Tensor) -> tuple[Tensor, Tensor]:
        """Of each row the log-probability of what the expert says, and whether the most probable action is right."""
        return dist.log_prob(expert), dist.mode == expert


class OptimalActionsLoss(ImitationLoss):
    """Negative log-probability that the actor takes any of the optimal actions.

    Often several actions begin a shortest path. The cross-entropy with one of them (`ImitationLoss`) penalises the
    others; this loss leaves the choice to the actor, and is 0 once it takes optimal actions only.

    Args and returns are those of `ImitationLoss`; ``accuracy`` is the fraction of rows in which the most probable
    action is optimal. In keys are the actor's and ``optimal_actions``, bool ``[B, A]``.
    """

    @dataclass
    class _AcceptedKeys:
        optimal_actions: NestedKey = "optimal_actions"

    default_keys = _AcceptedKeys

    def _compare(self, dist: Categorical, expert: Tensor) -> tuple[Tensor, Tensor]:
        log_chance = dist.logits.log_softmax(-1).masked_fill(~expert, -torch.inf).logsumexp(-1)
        return log_chance, expert.gather(-1, dist.mode.unsqueeze(-1))
