"""What an update minimises (paper sections 3.2 and 3.3): losses, advantages, and the steps of the optimiser.

One pass through the trunk, then every loss on the heads. Of single losses and optimisers here are those that TorchRL
and torch lack, or have otherwise.
"""

import inspect
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import ProbabilisticTensorDictSequential, TensorDictModuleBase
from torch import Tensor, nn
from torch.distributions import Categorical
from torch.optim import Optimizer
from torchrl.modules import set_recurrent_mode
from torchrl.objectives.value import GAE
from torchrl.objectives.value.functional import generalized_advantage_estimate

from dirl.config.schemas import ConfigError, Schedule
from dirl.models import ActorCritic, initial_state, recurrent_keys
from dirl.training.pairs import Demonstrations, DrawnPairs

EXPERT = {"expert_action", "optimal_actions"}
"""A loss that reads one of these keys is computed on demonstrations; every other one on rollouts, or on both."""

FULL_BATCH = 20_000
"""Demonstrations that an update learns from all together, unless ``imitation.batch_size`` says otherwise."""

MINIBATCH = 512
"""Of more than that so many are sampled."""


class ScheduledLoss:
    """A loss with the coefficients that change linearly over the training.

    Args:
        module: reads a batch and writes ``loss_*`` entries, as TorchRL's ``LossModule`` does.
        schedules: ``weight``, which multiplies the loss, and attributes of the module by name.
    """

    def __init__(self, module: Any, schedules: Mapping[str, Schedule]) -> None:
        self.module, self.schedules = module, dict(schedules)
        self.on_demonstrations = not EXPERT.isdisjoint(module.in_keys)
        """True if it is computed on demonstrations."""
        self.compares = "demonstrations" in list(inspect.signature(module.forward).parameters)[1:]
        """True if it is computed on rollouts and demonstrations together: ``forward(batch, demonstrations)``."""


class Losses(nn.Module):
    """All losses of an update, by name.

    The policy's trunk is computed once for all rows, and writes ``hidden`` with gradients; the losses read it. Losses
    that have parameters of their own are trained with the policy. For ``batch_size`` see `demonstration_batches`.
    """

    def __init__(
        self,
        policy: ActorCritic,
        losses: Mapping[str, ScheduledLoss],
        demonstrations: Demonstrations,
        batch_size: int | None = None,
    ) -> None:
        super().__init__()
        self.trunk = policy.trunk()
        self.modules_by_name = nn.ModuleDict({name: loss.module for name, loss in losses.items()})
        self.losses = dict(losses)
        self.on_rollouts = any(not loss.on_demonstrations for loss in losses.values())
        """True if any loss needs rollouts."""
        self.recurrent = recurrent_keys(policy)
        self.draw = demonstration_batches(policy, demonstrations, batch_size)

    def forward(self, batch: TensorDictBase, left: float | Tensor) -> TensorDict:
        """Return the weighted losses of a batch.

        Args:
            batch: steps with advantages, ``[B]``; ``[B, T]`` for a policy with memory.
            left: the fraction of the training that is still to come, 1 to 0.

        Returns:
            ``loss_*`` entries, scalars that carry gradients, and what else the losses report.
        """
        demonstrated = any(loss.on_demonstrations or loss.compares for loss in self.losses.values())
        return self.compute(batch, self.draw() if demonstrated else None, self.coefficients(float(left)))

    def coefficients(self, left: Any) -> dict[str, dict[str, Any]]:
        """Return each loss's coefficients, by its name and theirs, when a fraction ``left`` of the training remains."""
        return {
            name: {option: schedule(left) for option, schedule in loss.schedules.items()}
            for name, loss in self.losses.items()
        }

    def compute(
        self,
        batch: TensorDictBase,
        rows: TensorDictBase | None,
        coefficients: Mapping[str, Mapping[str, Any]],
        reduce: Callable[[str, Tensor], Tensor] = lambda _, value: value,
    ) -> TensorDict:
        """Return the weighted losses of a batch and of demonstrations, see `forward`.

        ``reduce`` makes one number of what the loss of a name gives for each row, if it is not reduced.
        """
        keys = self.trunk.in_keys
        # All rows go through the trunk in one pass, unless a memory needs the batch as episodes.
        if self.recurrent:
            with set_recurrent_mode(True):
                batch = self.trunk(batch.copy()).reshape(-1)
            rows = None if rows is None else self.trunk(rows.copy())
        elif rows is None:
            batch.set("hidden", self.trunk(batch.select(*keys))["hidden"])
        else:
            hidden = self.trunk(torch.cat([batch.select(*keys), rows.select(*keys)]))["hidden"]
            batch.set("hidden", hidden[: len(batch)])
            rows = rows.copy().set("hidden", hidden[len(batch) :])
        result = TensorDict()
        for name, loss in self.losses.items():
            weight = coefficients[name]["weight"]
            for option, value in coefficients[name].items():
                if option != "weight":
                    setattr(loss.module, option, value)
            inputs = (batch, rows) if loss.compares else (rows,) if loss.on_demonstrations else (batch,)
            values = loss.module(*inputs)
            if twice := set(values.keys()) & set(result.keys()):
                raise ConfigError(f"losses.{name}: writes {min(twice)}, as another loss does")
            terms = {key for key in values.keys() if key.startswith("loss_")}  # noqa: SIM118, of a TensorDict
            if not terms:
                raise ConfigError(f"losses.{name}: {type(loss.module).__name__} writes no loss_* entry")
            for key, value in values.items():
                reduced = reduce(name, value)
                if key in terms and reduced.ndim:
                    raise ConfigError(f"losses.{name}: gives {key} {list(reduced.shape)}; expected one number, []")
                result[key] = weight * reduced if key in terms else reduced
        return result

    @torch.no_grad()
    def rewarded(self, batch: TensorDictBase) -> TensorDictBase:
        """Return a rollout, ``[B, T]``, with the reward of the losses that define one, as a discriminator does.

        Their ``reward`` reads the rollout with ``hidden`` and returns the reward of each step, float32 ``[B, T, 1]``.

        Raises:
            ConfigError: it returns another shape.
        """
        for name, loss in self.losses.items():
            if hasattr(loss.module, "reward"):
                with set_recurrent_mode(bool(self.recurrent)):
                    seen = self.trunk(batch.copy())
                reward, shape = loss.module.reward(seen), batch["next", "reward"].shape
                if reward.shape != shape:
                    raise ConfigError(f"losses.{name}: reward() gives {list(reward.shape)}; expected {list(shape)}")
                batch["next", "reward"] = reward
        return batch


def demonstration_batches(
    policy: nn.Module, demonstrations: Demonstrations, batch_size: int | None
) -> Callable[[], TensorDictBase]:
    """Return a function that gives the demonstrations of an update, see `as_first_steps`.

    Args:
        policy: that learns from them.
        demonstrations: ``[M]``; or pairs, of which a batch is sampled for each update.
        batch_size: rows sampled anew for each update, uniformly with replacement; all of them if it is not less than M.
            None: all, or `MINIBATCH` of more than `FULL_BATCH`; of pairs always `MINIBATCH`.
    """
    if isinstance(demonstrations, DrawnPairs):
        return lambda: as_first_steps(policy, demonstrations.draw(batch_size or MINIBATCH))
    count = len(demonstrations)
    wanted = batch_size or (count if count <= FULL_BATCH else MINIBATCH)
    if wanted >= count:
        rows = as_first_steps(policy, demonstrations)
        return lambda: rows
    device = demonstrations["state"].device
    return lambda: as_first_steps(policy, demonstrations[torch.randint(count, (wanted,), device=device)])


def as_first_steps(policy: nn.Module, demonstrations: TensorDictBase) -> TensorDictBase:
    """Return demonstrations as first steps of episodes, with the initial recurrent state of a policy with memory."""
    count, device = len(demonstrations), demonstrations["state"].device
    if not recurrent_keys(policy) or not count:
        return demonstrations
    begins = torch.ones((count, 1), dtype=torch.bool, device=device)
    return demonstrations.copy().update({"is_init": begins, **initial_state(policy, count, device)})


def trained_parameters(policy: nn.Module, losses: nn.Module | None = None) -> list[nn.Parameter]:
    """Return the parameters of the policy, then the losses' own; each once."""
    both = [*policy.parameters(), *(losses.parameters() if losses is not None else [])]
    return list(dict.fromkeys(parameter for parameter in both if parameter.requires_grad))


class ImitationLoss(nn.Module):
    """Cross-entropy between the expert's action and the actor's distribution (paper equation 12).

    TorchRL 0.14's own ``BCLoss`` fails for actors over discrete actions. The actor is anything with ``get_dist``, the
    reduction ``mean``, ``sum`` or ``none``.

    Returns of ``forward``: ``loss_imitation`` (scalar) and ``accuracy``, the fraction of rows in which the most
    probable action is the expert's. In keys are the actor's and ``expert_action``, int64 ``[B]``.
    """

    expert_key = "expert_action"

    def __init__(self, actor: ProbabilisticTensorDictSequential, *, reduction: str = "mean") -> None:
        super().__init__()
        self.actor_network, self.reduction = actor, reduction
        self.in_keys = [self.expert_key, *actor.in_keys]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Return the loss of a batch of demonstrations, see the class."""
        dist = self.actor_network.get_dist(tensordict.select(*self.actor_network.in_keys))
        log_chance, right = self._compare(dist, tensordict[self.expert_key])
        if self.reduction == "none":
            return TensorDict({"loss_imitation": -log_chance, "accuracy": right.float()})
        loss = -log_chance.sum() if self.reduction == "sum" else -log_chance.mean()
        return TensorDict({"loss_imitation": loss, "accuracy": right.float().mean()})

    def _compare(self, dist: Categorical, expert: Tensor) -> tuple[Tensor, Tensor]:
        """Return each row's log-probability of the expert's action, and whether the most probable action is right."""
        return dist.log_prob(expert), dist.mode == expert


class OptimalActionsLoss(ImitationLoss):
    """Negative log-probability that the actor takes any of the optimal actions.

    Often several actions begin a shortest path. The cross-entropy with one of them (`ImitationLoss`) penalises the
    others; this loss leaves the choice to the actor, and is 0 once it takes optimal actions only.

    Arguments and results are those of `ImitationLoss`; ``accuracy`` is the fraction of rows in which the most probable
    action is optimal. In keys are the actor's and ``optimal_actions``, bool ``[B, A]``.
    """

    expert_key = "optimal_actions"

    def _compare(self, dist: Categorical, expert: Tensor) -> tuple[Tensor, Tensor]:
        log_chance = dist.logits.log_softmax(-1).masked_fill(~expert, -torch.inf).logsumexp(-1)
        return log_chance, expert.gather(-1, dist.mode.unsqueeze(-1))


def make_advantages(gamma: float | Tensor, lmbda: float | Tensor) -> Callable[[TensorDictBase], TensorDictBase]:
    """Make TorchRL's generalised advantage estimation over values that are already in the batch.

    With ``lmbda=1`` it is the paper's n-step return minus the value (equations 5 and 6). Tensors, ``[R, 1, 1, 1]``, are
    those of the runs of a stack, whose batches are ``[R, B, T]``.
    """
    if not isinstance(gamma, Tensor):
        return GAE(gamma=gamma, lmbda=lmbda, value_network=None, deactivate_vmap=True)

    def step_by_step(batch: TensorDictBase) -> TensorDictBase:
        # The module takes one gamma, and its shapes depend on where episodes end.
        after = batch["next"]
        given = (batch["state_value"], after["state_value"], after["reward"], after["done"], after["terminated"])
        advantage, target = generalized_advantage_estimate(gamma, lmbda, *given)
        return batch.update({"advantage": advantage, "value_target": target})

    return step_by_step


@torch.no_grad()
def bootstrap(batch: TensorDictBase, critic: TensorDictModuleBase) -> TensorDictBase:
    """Write the value of each step's next state, ``("next", "state_value")`` float32 ``[B, T, 1]``.

    Within an episode it is the value of the following step, known from the rollout. The critic is only evaluated
    for the states after the last step and where an episode was truncated.

    Args:
        batch: ``[B, T]`` with ``state_value``; or ``[R, B, T]`` of the runs of a stack.
        critic: the whole value operator, from views to ``state_value``.
    """
    if batch.batch_dims > 2:  # a stack looks values up, and no shape of its may depend on them
        batch["next", "state_value"] = critic(batch["next"].select(*critic.in_keys))["state_value"]
        return batch
    values = torch.zeros_like(batch["state_value"])
    values[:, :-1] = batch["state_value"][:, 1:]
    unknown = batch["next", "truncated"].squeeze(-1).clone()
    unknown[:, -1] = True
    values[unknown] = critic(batch["next"].select(*critic.in_keys)[unknown])["state_value"]
    batch["next", "state_value"] = values
    return batch


def minibatches(batch: TensorDictBase, epochs: int, count: int, *, by_agent: bool = False) -> Iterator[TensorDictBase]:
    """Yield the batches of the updates after one rollout ``[B, T]``: all of it, or shuffled parts, in several passes.

    With ``by_agent`` the steps of an agent stay together and in order, ``[b, T]``, as a memory needs; else ``[b]``.
    """
    rows = batch if by_agent else batch.flatten(-2, -1)
    for _ in range(epochs):
        if count == 1:
            yield rows
        else:
            yield from (rows[part] for part in torch.randperm(len(rows)).chunk(count))


@torch.no_grad()
def clip_gradients(
    parameters: list[nn.Parameter], max_norm: float, *, per_variable: bool, stacked: bool = False
) -> Tensor:
    """Scale gradients down to a norm: of all variables together, or of each variable as TensorFlow does.

    With ``stacked`` variables are ``[R, ...]``, of R runs, and those of each run are scaled by themselves.

    Returns:
        The norm of all together as it was before, float32 ``[]``, or ``[R]``.
    """
    gradients = [parameter.grad for parameter in parameters if parameter.grad is not None]
    norms = [gradient.reshape((*gradient.shape[: int(stacked)], -1)).norm(dim=-1) for gradient in gradients]
    norm = torch.stack(norms).norm(dim=0)
    whole = (max_norm / (norm + 1e-6)).clamp(max=1)
    for gradient, own in zip(gradients, norms, strict=True):
        scale = max_norm / own.clamp(min=max_norm) if per_variable else whole
        gradient.mul_(scale.view(scale.shape + (1,) * (gradient.ndim - scale.ndim)))
    return norm


def set_learning_rate(optimiser: Any, rate: Any) -> None:
    """Give every group of parameters the same learning rate, or each its own, ``[groups]``.

    It is given in place where it is a tensor, as in a CUDA graph.
    """
    for number, group in enumerate(optimiser.param_groups):
        own = rate[number] if isinstance(rate, Tensor) and rate.ndim else rate
        if isinstance(group["lr"], Tensor):
            group["lr"].copy_(own)
        else:
            group["lr"] = float(own)


class TFRMSprop(Optimizer):
    """RMSProp as TensorFlow's ``ApplyRMSProp`` computes it.

    ``ms = alpha ms + (1 - alpha) g^2``, then ``w = w - lr g / sqrt(ms + eps)``. It differs from
    `torch.optim.RMSprop` in two ways that matter with the published ``eps`` of 0.1: epsilon is inside the root, and
    the mean square starts at one, not zero.
    """

    def __init__(self, params: Iterable[nn.Parameter], lr: float = 7e-4, alpha: float = 0.99, eps: float = 0.1) -> None:
        super().__init__(params, {"lr": lr, "alpha": alpha, "eps": eps})

    @torch.no_grad()
    def step(self, closure: None = None) -> None:  # type: ignore[override]
        """Update every parameter that has a gradient."""
        for group in self.param_groups:
            for parameter in group["params"]:
                if parameter.grad is None:
                    continue
                square = self.state[parameter].setdefault("mean_square", torch.ones_like(parameter))
                square.mul_(group["alpha"]).addcmul_(parameter.grad, parameter.grad, value=1 - group["alpha"])
                parameter.addcdiv_(parameter.grad, (square + group["eps"]).sqrt(), value=-group["lr"])
