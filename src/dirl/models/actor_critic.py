"""The whole network (paper figure 2), and its form as TorchRL's actor-critic operator."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torch import Tensor, nn
from torch.distributions import Categorical
from torchrl.data import Composite
from torchrl.envs import TensorDictPrimer
from torchrl.modules import ActorValueOperator, ProbabilisticActor

from dirl.envs.transforms import VIEWS
from dirl.models.distinct import Cacheable, CachedEncoder
from dirl.models.features import FeatureTable, ObservationTable
from dirl.models.heads import ActorCriticHeads, SceneTrunks

VIEW_IDS = ("view_ids", "goal_view_ids")
OBSERVATIONS = ("observation", "goal_observation")


class KeyedModule(TensorDictModuleBase):
    """A module that reads its inputs from a tensordict of any batch size, and writes its output to it.

    Each call of ``TensorDictModule`` in tensordict 0.14 searches the disk for pandas, a third of a rollout's time.

    The module takes one tensor ``[B, ...]`` for each of ``in_keys``.
    """

    def __init__(self, module: nn.Module, in_keys: Sequence[str], out_key: str) -> None:
        super().__init__()
        self.module = module
        self.in_keys = list(in_keys)
        self.out_keys = [out_key]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Call the module."""
        arguments = [tensordict.get(key) for key in self.in_keys]
        dims = tensordict.batch_dims
        if dims <= 1:
            return tensordict.set(self.out_keys[0], self.module(*arguments))
        result = self.module(*(argument.flatten(0, dims - 1) for argument in arguments))
        return tensordict.set(self.out_keys[0], result.unflatten(0, tensordict.batch_size))


class ActorCritic(TensorDictModuleBase):
    """Encoder, optional memory, and heads, applied to the features that view ids refer to.

    Reads ``view_ids``, ``goal_view_ids`` (int64 ``[B, 4]``) and ``scene`` (int64 ``[B]``); with a memory also
    ``is_init`` and its recurrent state. Writes ``hidden``, ``logits`` ``[B, A]`` and ``state_value`` ``[B, 1]``.
    What is trained is `operator`, which draws actions as well.

    Args:
        features: of the states.
        encoder: features of observation and goal, float32 ``[B, 4, D]`` each, to ``fused`` ``[B, width]``.
        heads: ``trunk``, ``policy`` and ``value``, see `ActorCriticHeads`.
        memory: reads ``fused`` and writes ``memory``, as TorchRL's ``GRUModule`` and ``LSTMModule`` do.
    """

    def __init__(
        self,
        features: FeatureTable,
        encoder: nn.Module,
        heads: ActorCriticHeads,
        memory: TensorDictModuleBase | None = None,
    ) -> None:
        super().__init__()
        self.features = features
        self.encoder = encoder
        self.memory = memory
        self.heads = heads
        self.cached: CachedEncoder | None = None
        self.in_keys, self.out_keys = [*VIEW_IDS, "scene"], ["hidden", "logits", "state_value"]
        if memory is not None:
            self.in_keys += [key for key in memory.in_keys if key != "fused"]
            self.out_keys += [key for key in memory.out_keys if key != "memory"]

    def cache(self, surrounding: Tensor | None, *, views: int = VIEWS, front: bool = False) -> None:
        """From now on embed each distinct observation once, see `CachedEncoder`; faster, but not for ``torch.vmap``.

        An encoder without `Cacheable`'s parts embeds every row as before.
        """
        if isinstance(self.encoder, Cacheable):
            self.cached = CachedEncoder(self.encoder, self.features, surrounding, views=views, front=front)
        for module in self.heads.modules():
            if isinstance(module, SceneTrunks):
                module.sorts = True

    def trunk(self) -> TensorDictSequential:
        """From view ids to ``hidden``."""
        if self.cached is not None:
            modules: list[Any] = [KeyedModule(self.cached, VIEW_IDS, "fused")]
        else:
            pairs = zip(VIEW_IDS, OBSERVATIONS, strict=True)
            modules = [KeyedModule(self.features, [ids], observation) for ids, observation in pairs]
            modules.append(KeyedModule(self.encoder, OBSERVATIONS, "fused"))
        if self.memory is not None:
            modules.append(self.memory)
        encoded = "fused" if self.memory is None else "memory"
        return TensorDictSequential(*modules, KeyedModule(self.heads.trunk, [encoded, "scene"], "hidden"))

    def operator(self) -> ActorValueOperator:
        """TorchRL's operators on these weights: a common trunk to ``hidden``, and two small heads on it.

        The losses are given the heads only, so that the trunk runs once an update for actor and critic together.
        """
        actor = ProbabilisticActor(
            KeyedModule(self.heads.policy, ["hidden", "scene"], "logits"),
            in_keys=["logits"],
            distribution_class=Categorical,
            distribution_kwargs={"validate_args": False},
            return_log_prob=True,
        )
        critic = KeyedModule(self.heads.value, ["hidden", "scene"], "state_value")
        return ActorValueOperator(self.trunk(), actor, critic)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``hidden``, ``logits`` and ``state_value``, see the class."""
        self.trunk()(tensordict)
        hidden, scene = tensordict["hidden"].flatten(0, -2), tensordict["scene"].flatten()
        for key, head in (("logits", self.heads.policy), ("state_value", self.heads.value)):
            tensordict.set(key, head(hidden, scene).unflatten(0, tensordict.batch_size))
        return tensordict


def count_parameters(network: nn.Module) -> int:
    """The number of trainable values."""
    return sum(parameter.numel() for parameter in network.parameters() if parameter.requires_grad)


def caching(policy: nn.Module) -> AbstractContextManager[None]:
    """A context in which each observation is embedded once between two weight updates, if the policy supports it."""
    cached = getattr(policy, "cached", None)
    return nullcontext() if cached is None else cached.caching()


def frozen(policy: nn.Module) -> AbstractContextManager[None]:
    """A context for evaluation: the weights must not change, so that the policy may precompute embeddings."""
    cached = getattr(policy, "cached", None)
    return nullcontext() if cached is None else cached.frozen()


def noisy(policy: nn.Module, deviation: float) -> AbstractContextManager[None]:
    """A context in which Gaussian noise is added to the views, see `FeatureTable`."""
    return policy.features.noisy(deviation) if deviation else nullcontext()  # type: ignore[union-attr, operator]


def plain_weights(policy: nn.Module) -> dict[str, Tensor]:
    """A policy's weights as a layer on features has them, also those that are learned on coordinates."""
    weights = dict(policy.state_dict())
    table = getattr(policy, "features", None)
    if isinstance(table, ObservationTable):
        del weights["features.coordinates"]
        for layer in policy.encoder.linear:  # type: ignore[union-attr]
            name = f"encoder.{layer}.weight"
            weights[name] = table.widen(weights[name])
    return weights


def recurrent_keys(policy: nn.Module) -> list[str]:
    """The keys of a policy's recurrent state; empty for a policy without memory."""
    written = [key for key in getattr(policy, "out_keys", []) if isinstance(key, tuple) and key[0] == "next"]
    return [key[1] for key in written]


def state_primer(policy: nn.Module) -> TensorDictPrimer:
    """TorchRL's transform that gives every episode the recurrent state to begin with, zeros.

    Raises:
        ValueError: the memory names no such state for a key that it writes.
    """
    specs = Composite()
    for module in policy.modules():
        make: Callable[[], TensorDictPrimer] | None = getattr(module, "make_tensordict_primer", None)
        if make is not None:
            primer = make()
            if primer.random or any(value != 0 for value in primer.default_value.values()):
                raise ValueError("its recurrent state must begin with zeros, see make_tensordict_primer()")
            specs.update(primer.primers)
    if missing := [key for key in recurrent_keys(policy) if key not in specs.keys()]:  # noqa: SIM118, of a Composite
        raise ValueError(f"writes the state '{missing[0]}', which make_tensordict_primer() does not name")
    return TensorDictPrimer(specs, expand_specs=True)


def initial_state(policy: nn.Module, batch: int, device: torch.device) -> dict[str, Tensor]:
    """A policy's recurrent state at the beginning of an episode, ``[batch, ...]`` by key; empty without memory."""
    if not recurrent_keys(policy):
        return {}
    specs = state_primer(policy).primers
    return {key: specs[key].zero([batch]).to(device) for key in recurrent_keys(policy)}
