"""Losses, advantages and optimisers that TorchRL and torch lack, or have otherwise (paper sections 3.2 and 3.3)."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from tensordict.nn import ProbabilisticTensorDictSequential, TensorDictModuleBase, dispatch
from torch import Tensor
from torch.distributions import Categorical
from torch.optim import Optimizer
from torchrl.objectives import LossModule
from torchrl.objectives.value import GAE
from torchrl.objectives.value.functional import generalized_advantage_estimate


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
        accuracy = right.float() if self.reduction == "none" else right.float().mean()
        return TensorDict({"loss_imitation": loss, "accuracy": accuracy})

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


class TFRMSprop(Optimizer):
    """RMSProp as TensorFlow's ``ApplyRMSProp`` computes it.

    ``ms = alpha ms + (1 - alpha) g^2``, then ``w = w - lr g / sqrt(ms + eps)``. It differs from
    `torch.optim.RMSprop` in two ways that matter with the published ``eps`` of 0.1: epsilon is inside the root, and
    the mean square starts at one, not zero.

    Args:
        params: the parameters to optimise.
        lr: learning rate.
        alpha: decay of the mean square.
        eps: see above.
    """

    def __init__(self, params: Iterable[Any], lr: float = 7e-4, alpha: float = 0.99, eps: float = 0.1) -> None:
        super().__init__(params, {"lr": lr, "alpha": alpha, "eps": eps})

    @torch.no_grad()
    def step(self, closure: Callable[[], float] | None = None) -> float | None:  # type: ignore[override]
        """Update every parameter that has a gradient."""
        loss = None
        if closure is not None:
            with torch.enable_grad():
                loss = closure()
        for group in self.param_groups:
            parameters = [p for p in group["params"] if p.grad is not None]
            if not parameters:
                continue
            for parameter in parameters:
                if not self.state[parameter]:
                    self.state[parameter]["mean_square"] = torch.ones_like(parameter)
            gradients = [p.grad for p in parameters]
            squares = [self.state[p]["mean_square"] for p in parameters]
            torch._foreach_mul_(squares, group["alpha"])
            torch._foreach_addcmul_(squares, gradients, gradients, 1 - group["alpha"])
            roots = torch._foreach_add(squares, group["eps"])
            torch._foreach_sqrt_(roots)
            torch._foreach_addcdiv_(parameters, gradients, roots, -group["lr"])
        return loss


@torch.no_grad()
def clip_each(parameters: Iterable[Tensor], max_norm: float) -> None:
    """Scale the gradient of each variable by itself to at most ``max_norm`` (TensorFlow's ``clip_by_norm``)."""
    for parameter in parameters:
        if parameter.grad is not None:
            norm = parameter.grad.norm()
            parameter.grad.mul_(max_norm / norm.clamp(min=max_norm))
