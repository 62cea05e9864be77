"""Scene-specific layers: each scene has weights of its own, and each row goes through those of its scene."""

from collections.abc import Callable, Sequence

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dirl.models.fast.caching import answers_late


class SceneLayers(nn.Module):
    """One module for each scene; row by row the one that ``scene`` names is applied.

    Rows are sorted by scene, split, and put back; on a GPU, which would have to tell how many there are of each, every
    layer is applied to all of them. (A stacked parameter would lose the scenes' names in the state_dict, and with them
    adding or freezing a scene.)

    Args:
        scenes: the scenes' names, in the order of the world; a single name serves every scene.
        make: makes one scene's module.

    Raises:
        ValueError: two scenes have the same name, or differ only in dots and underscores.
    """

    def __init__(self, scenes: Sequence[str], make: Callable[[], nn.Module]) -> None:
        super().__init__()
        self.scenes = _by_name(scenes, make)

    def forward(self, rows: Tensor, scene: Tensor) -> Tensor:
        """Rows ``[B, F]`` of scenes int64 ``[B]``, to ``[B, F']``."""
        layers = list(self.scenes.values())
        if len(layers) == 1:
            return layers[0](rows)
        if answers_late(rows):
            return _pick(torch.stack([layer(rows) for layer in layers], 1), scene)
        sizes = torch.bincount(scene, minlength=len(layers)).tolist()
        order = torch.argsort(scene, stable=True)
        parts = rows.index_select(0, order).split(sizes)
        done = torch.cat([layer(part) for layer, part in zip(layers, parts, strict=True)])
        return done.index_select(0, torch.argsort(order))


class SceneHeads(nn.Module):
    """One small linear layer for each scene; row by row the one that ``scene`` names is applied.

    All of them are applied to all rows at once and the right outputs picked: for a handful of outputs that is faster
    than to sort the rows.

    Args:
        scenes: as for `SceneLayers`.
        width: F, of the rows.
        outputs: F', of each layer.
    """

    def __init__(self, scenes: Sequence[str], width: int, outputs: int) -> None:
        super().__init__()
        self.scenes = _by_name(scenes, lambda: nn.Linear(width, outputs))

    def forward(self, rows: Tensor, scene: Tensor) -> Tensor:
        """Rows ``[B, F]`` of scenes int64 ``[B]``, to ``[B, F']``."""
        layers = list(self.scenes.values())
        if len(layers) == 1:
            return layers[0](rows).float()
        weight, bias = (torch.cat([getattr(layer, name) for layer in layers]) for name in ("weight", "bias"))
        return _pick(F.linear(rows, weight, bias).unflatten(1, (len(layers), -1)), scene).float()


def _pick(every: Tensor, scene: Tensor) -> Tensor:
    """Of what every scene's layer made of the rows, ``[B, S, F]``, that of each row's scene, ``[B, F]``."""
    return every.take_along_dim(scene[:, None, None], 1).squeeze(1)


def _by_name(scenes: Sequence[str], make: Callable[[], nn.Module]) -> nn.ModuleDict:
    modules = nn.ModuleDict({name.replace(".", "_"): make() for name in scenes})
    if len(modules) < len(scenes):
        raise ValueError(f"the scenes' names must differ by more than dots and underscores: {list(scenes)}")
    return modules
