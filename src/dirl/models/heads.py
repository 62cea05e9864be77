"""Scene-specific layers: each scene has its own weights, and each row is passed through those of its scene."""

from collections.abc import Callable, Sequence
from typing import Annotated

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dirl.config.bounds import Bounds
from dirl.models.distinct import reading_waits


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
        width: Annotated[int, Bounds(1, 65_536)] = 512,
        shared: bool = False,
    ) -> None:
        super().__init__()
        names = ["shared"] if shared else list(scenes)
        self.width = width
        self.trunk = SceneTrunks(names, lambda: nn.Sequential(nn.Linear(in_features, width), nn.ReLU()))
        self.policy = SceneLinear(names, width, num_actions)
        self.value = SceneLinear(names, width, 1)


class SceneTrunks(nn.Module):
    """One module for each scene; each row is passed through the module of its scene.

    Every layer is applied to all rows, and each row takes what its scene's has made of it: plain, also for
    ``torch.vmap`` and `torch.func`. With ``sorts`` rows are sorted by scene, split, and put back, a fraction of the
    work; but not on a GPU, for which the CPU would have to wait to count the rows of each scene. (A stacked parameter
    would lose the scenes' names in the state_dict, and with them adding or freezing a scene.)

    Args:
        scenes: the scenes' names, in the order of the world; a single name serves every scene.
        make: makes one scene's module.

    Raises:
        ValueError: two scenes have the same name, or differ only in dots and underscores.
    """

    def __init__(self, scenes: Sequence[str], make: Callable[[], nn.Module]) -> None:
        super().__init__()
        self.scenes = _by_name(scenes, make)
        self.sorts = False

    def forward(self, rows: Tensor, scene: Tensor) -> Tensor:
        """Rows ``[..., F]`` of scenes int64 ``[...]``, to ``[..., F']``."""
        layers = list(self.scenes.values())
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


class SceneLinear(nn.Module):
    """One small linear layer for each scene; each row is passed through the layer of its scene, see `SceneTrunks`.

    All layers are applied to all rows, and the outputs of the right layer are selected. For a few outputs this is
    faster than sorting the rows.
    """

    def __init__(self, scenes: Sequence[str], width: int, outputs: int) -> None:
        super().__init__()
        self.scenes = _by_name(scenes, lambda: nn.Linear(width, outputs))

    def forward(self, rows: Tensor, scene: Tensor) -> Tensor:
        """Rows ``[..., F]`` of scenes int64 ``[...]``, to ``[..., F']``."""
        layers = list(self.scenes.values())
        if len(layers) == 1:
            return layers[0](rows).float()
        weight, bias = (torch.cat([getattr(layer, name) for layer in layers]) for name in ("weight", "bias"))
        return _pick(F.linear(rows, weight, bias).unflatten(-1, (len(layers), -1)), scene).float()


def _pick(every: Tensor, scene: Tensor) -> Tensor:
    """Of what every scene's layer made of the rows, ``[..., S, F]``, that of each row's scene, ``[..., F]``."""
    return every.take_along_dim(scene[..., None, None], -2).squeeze(-2)


def _by_name(scenes: Sequence[str], make: Callable[[], nn.Module]) -> nn.ModuleDict:
    modules = nn.ModuleDict({name.replace(".", "_"): make() for name in scenes})
    if len(modules) < len(scenes):
        raise ValueError(f"the scenes' names must differ by more than dots and underscores: {list(scenes)}")
    return modules
