"""The policy of the paper (figure 2): Siamese encoder, scene-specific layers, actor and critic.

`SiameseEncoder` embeds observation and goal by the same weights, `ActorCriticHeads` has the layers of each scene, and
`ActorCritic` puts them together, as a network and as TorchRL's actor-critic operator.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from copy import deepcopy
from typing import Annotated, ClassVar

import torch
import torch.nn.functional as F
from annotated_types import Interval
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torch import Tensor, nn
from torch.distributions import Categorical
from torchrl.data import Composite
from torchrl.envs import TensorDictPrimer
from torchrl.modules import ActorValueOperator, ProbabilisticActor

from dirl.envs.transforms import VIEWS
from dirl.models.distinct import Cacheable, CachedEncoder, packable, reading_waits
from dirl.models.features import FeatureTable, ObservationTable
from dirl.models.locator import GoalLocator

VIEW_IDS = ("view_ids", "goal_view_ids")
OBSERVATIONS = ("observation", "goal_observation")


class SiameseEncoder(nn.Module):
    """Encode four views of the agent and four of the goal as one vector.

    Observation and goal are embedded by the same layer; the next layer fuses both embeddings, ``W [e, g] + b``. This is
    ``(W_e e + b) + W_g g``, so that it is two layers here, whose outputs are computed once for all frames with the same
    observation or goal. `embed` and `embed_goal` give these.

    Args:
        num_features: D, of a view.
        width: of the embedding and of the fused vector.
        num_views: how many an observation has.
    """

    linear: ClassVar = ("embedding",)
    """The layers that read a whole observation, and so can read it in other coordinates as well."""

    def __init__(
        self, num_features: int, width: Annotated[int, Interval(ge=1, le=65_536)] = 512, num_views: int = VIEWS
    ) -> None:
        super().__init__()
        self.width, self.num_views = width, num_views
        self.embedding = nn.Linear(num_views * num_features, width)
        self.fusion = nn.utils.skip_init(nn.Linear, width, width)
        self.goal_fusion = nn.utils.skip_init(nn.Linear, width, width, bias=False)
        whole = nn.Linear(2 * width, width)  # as which both begin
        with torch.no_grad():
            self.fusion.weight.copy_(whole.weight[:, :width])
            self.fusion.bias.copy_(whole.bias)
            self.goal_fusion.weight.copy_(whole.weight[:, width:])

    def embed(self, observation: Tensor) -> Tensor:
        """Return what the observation adds to the fusion: features ``[..., 4, D]`` to ``[..., width]``."""
        return self.fusion(F.relu(self.embedding(observation.flatten(-2))))

    def embed_goal(self, goal_observation: Tensor) -> Tensor:
        """Return what the goal adds to the fusion: features ``[..., 4, D]`` to ``[..., width]``."""
        return self.goal_fusion(F.relu(self.embedding(goal_observation.flatten(-2))))

    def fuse(self, embedding: Tensor, goal_embedding: Tensor) -> Tensor:
        """Return what observation and goal add, ``[..., width]`` each, to the fused vector ``[..., width]``."""
        return F.relu(embedding + goal_embedding)

    def forward(self, observation: Tensor, goal_observation: Tensor) -> Tensor:
        """Encode features of observation and goal, float32 ``[..., 4, D]`` each, to a fused vector ``[..., width]``."""
        return self.fuse(self.embed(observation), self.embed_goal(goal_observation))


class ActorCriticHeads(nn.Module):
    """The layers after the encoder (paper figure 2): hidden layer, policy and value, for each scene or shared.

    Args:
        scenes: the scenes' names, in the order of the world.
        in_features: of the encoder's output, or the memory's.
        num_actions: outputs of the policy.
        width: of the hidden layer.
        shared: one set of layers for all scenes.
    """

    def __init__(
        self,
        scenes: Sequence[str],
        in_features: int,
        num_actions: int,
        width: Annotated[int, Interval(ge=1, le=65_536)] = 512,
        shared: bool = False,
    ) -> None:
        super().__init__()
        names = ["shared"] if shared else list(scenes)
        self.width = width
        self.trunk = SceneTrunks(names, lambda: nn.Sequential(nn.Linear(in_features, width), nn.ReLU()))
        self.policy = SceneLinear(names, lambda: nn.Linear(width, num_actions))
        self.value = SceneLinear(names, lambda: nn.Linear(width, 1))


class SceneTrunks(nn.Module):
    """One module for each scene; each row is passed through the module of its scene.

    Every layer is applied to all rows, and each row takes what its scene's has made of it: plain, also for
    ``torch.vmap`` and `torch.func`. With ``sorts`` rows are sorted by scene, split, and put back, a fraction of the
    work; but not on a GPU, for which the CPU would have to wait to count the rows of each scene. (A stacked parameter
    would lose the scenes' names in the state_dict, and with them adding or freezing a scene.)

    Scenes are given by name, in the order of the world; a single name serves every scene.

    Raises:
        ValueError: two scenes have the same name, or differ only in dots and underscores.
    """

    def __init__(self, scenes: Sequence[str], make: Callable[[], nn.Module]) -> None:
        super().__init__()
        self.scenes = nn.ModuleDict({name.replace(".", "_"): make() for name in scenes})
        if len(self.scenes) < len(scenes):
            raise ValueError(f"the scenes' names must differ by more than dots and underscores: {list(scenes)}")
        self.sorts, self.only = False, slice(None)

    def forward(self, rows: Tensor, scene: Tensor) -> Tensor:
        """Apply each row's scene's layers: rows ``[..., F]`` of scenes int64 ``[...]``, to ``[..., F']``."""
        layers = list(self.scenes.values())[self.only]
        if len(layers) == 1:
            return layers[0](rows)
        if not self.sorts or reading_waits(scene):
            return _pick(torch.stack([layer(rows) for layer in layers], -2), scene)
        flat = scene.flatten()
        sizes = torch.bincount(flat, minlength=len(layers)).tolist()
        order = torch.argsort(flat, stable=True)
        parts = rows.flatten(0, -2).index_select(0, order).split(sizes)
        done = torch.cat([layer(part) for layer, part in zip(layers, parts, strict=True)])
        return done.index_select(0, torch.argsort(order)).unflatten(0, scene.shape)


class SceneLinear(SceneTrunks):
    """`SceneTrunks` of one small linear layer a scene.

    All layers are applied to all rows, and the outputs of the right layer are selected. For a few outputs this is
    faster than sorting the rows.
    """

    def forward(self, rows: Tensor, scene: Tensor) -> Tensor:
        """Apply each row's scene's layers: rows ``[..., F]`` of scenes int64 ``[...]``, to ``[..., F']``."""
        layers = list(self.scenes.values())[self.only]
        if len(layers) == 1:
            return layers[0](rows).float()
        weight, bias = (torch.cat([getattr(layer, name) for layer in layers]) for name in ("weight", "bias"))
        return _pick(F.linear(rows, weight, bias).unflatten(-1, (len(layers), -1)), scene).float()


def _pick(every: Tensor, scene: Tensor) -> Tensor:
    """Pick each row's scene, ``[..., F]``, from what every scene's layer made of the rows, ``[..., S, F]``."""
    if torch.is_grad_enabled() and reading_waits(every):  # a GPU would sort to take gradients back in a fixed order
        own = scene[..., None] == torch.arange(every.shape[-2], device=scene.device)
        return (every * own[..., None]).sum(-2)
    return every.take_along_dim(scene[..., None, None], -2).squeeze(-2)


class Actions(Categorical):
    """A distribution over actions, of whose log-probabilities a GPU takes gradients back without sorting."""

    deterministic_sample = Categorical.mode  # by this name tensordict asks for it

    def log_prob(self, value: Tensor) -> Tensor:
        """Return the log-probability of actions, int64 ``[...]``."""
        if not reading_waits(value):
            return super().log_prob(value)
        others = value[..., None] != torch.arange(self.logits.shape[-1], device=value.device)
        return self.logits.masked_fill(others, 0).sum(-1)


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
        locates: moves within which a second encoder like the first locates the goal, see
            `dirl.models.locator.GoalLocator`; 0 = none does.
    """

    def __init__(
        self,
        features: FeatureTable,
        encoder: nn.Module,
        heads: ActorCriticHeads,
        memory: TensorDictModuleBase | None = None,
        locates: Annotated[int, Interval(ge=0, le=64)] = 0,
    ) -> None:
        super().__init__()
        self.features = features
        self.encoder = encoder
        self.memory = memory
        self.heads = heads
        self.locator = GoalLocator(deepcopy(encoder), heads.width, locates) if locates else None
        self.cached: CachedEncoder | None = None
        self.in_keys, self.out_keys = [*VIEW_IDS, "scene"], ["hidden", "logits", "state_value"]
        if memory is not None:
            self.in_keys += [key for key in memory.in_keys if key != "fused"]
            self.out_keys += [key for key in memory.out_keys if key != "memory"]

    def cache(self, surrounding: Tensor | None, *, views: int = VIEWS, front: bool = False) -> None:
        """Embed each distinct observation once from now on, see `CachedEncoder`; faster, but not for ``torch.vmap``.

        An encoder without `Cacheable`'s parts, and one of very many views, embeds every row as before.
        """
        if isinstance(self.encoder, Cacheable) and (
            surrounding is not None or packable(len(self.features.table), views)
        ):
            self.cached = CachedEncoder(self.encoder, self.features, surrounding, views=views, front=front)
        for module in self.heads.modules():
            if isinstance(module, SceneTrunks):
                module.sorts = True

    def trunk(self) -> TensorDictSequential:
        """Return the modules from view ids to ``hidden``."""
        if self.cached is not None:
            modules: list[nn.Module] = [KeyedModule(self.cached, VIEW_IDS, "fused")]
        else:
            pairs = zip(VIEW_IDS, OBSERVATIONS, strict=True)
            modules = [KeyedModule(self.features, [ids], observation) for ids, observation in pairs]
            modules.append(KeyedModule(self.encoder, OBSERVATIONS, "fused"))
        if self.memory is not None:
            modules.append(self.memory)
        encoded = "fused" if self.memory is None else "memory"
        return TensorDictSequential(*modules, KeyedModule(self.heads.trunk, [encoded, "scene"], "hidden"))

    def operator(self) -> ActorValueOperator:
        """Return TorchRL's operators on these weights: a common trunk to ``hidden``, and two small heads on it.

        The losses are given the heads only, so that the trunk runs once an update for actor and critic together.
        """
        actor = ProbabilisticActor(
            KeyedModule(self.heads.policy, ["hidden", "scene"], "logits"),
            in_keys=["logits"],
            distribution_class=Actions,
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


def caching(policy: object, *, learns: bool) -> AbstractContextManager[None]:
    """Embed each observation once between two weight updates within this context, if the policy supports it.

    In a context that does not learn, as in evaluation, weights must not change.
    """
    cached = getattr(policy, "cached", None)
    return nullcontext() if cached is None else cached.keeping(learns=learns)


@contextmanager
def in_scene(policy: nn.Module, number: int) -> Iterator[None]:
    """Apply only one scene's layers within this context, in which all rows are of it."""
    modules = [layer for layer in policy.modules() if isinstance(layer, SceneTrunks) and len(layer.scenes) > 1]
    for module in modules:
        module.only = slice(number, number + 1)
    try:
        yield
    finally:
        for module in modules:
            module.only = slice(None)


def noisy(policy: object, deviation: float) -> AbstractContextManager[None]:
    """Add Gaussian noise to the views within this context, see `FeatureTable`."""
    return policy.features.noisy(deviation) if deviation else nullcontext()  # type: ignore[attr-defined]


def plain_weights(policy: nn.Module) -> dict[str, Tensor]:
    """Return a policy's weights as a layer on features has them, also those that are learned on coordinates."""
    weights = dict(policy.state_dict())
    table = getattr(policy, "features", None)
    if isinstance(table, ObservationTable):
        del weights["features.coordinates"]
        for layer in policy.encoder.linear:  # type: ignore[union-attr]
            name = f"encoder.{layer}.weight"
            weights[name] = table.widen(weights[name])
    return weights


def recurrent_keys(policy: nn.Module) -> list[str]:
    """Return the keys of a policy's recurrent state; empty for a policy without memory."""
    written = [key for key in getattr(policy, "out_keys", []) if isinstance(key, tuple) and key[0] == "next"]
    return [key[1] for key in written]


def state_primer(policy: nn.Module) -> TensorDictPrimer:
    """Return TorchRL's transform that gives every episode the recurrent state to begin with, zeros.

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
    """Return a policy's recurrent state at the start of an episode, ``[batch, ...]`` by key; empty without memory."""
    if not recurrent_keys(policy):
        return {}
    specs = state_primer(policy).primers
    return {key: specs[key].zero([batch]).to(device) for key in recurrent_keys(policy)}
