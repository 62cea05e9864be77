"""Scene-specific layers: each scene has weights of its own, and each row goes through those of its scene."""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn


class SceneLayers(nn.Module):
    """One module for each scene; row by row the one that ``scene`` names is applied.

    Rows are sorted by scene, split, and put back. (Computing all heads and picking is ten times slower; a stacked
    parameter would lose the scenes' names in the state_dict, and with them adding or freezing a scene.)

    Args:
        scenes: the scenes' names, in the order of the world; a single name serves every scene.
        make: makes one scene's module.

    Raises:
        ValueError: two scenes have the same name, or differ only in dots and underscores.
    """

    def __init__(self, scenes: Sequence[str], make: Callable[[], nn.Module]) -> None:
        super().__init__()
        self.scenes = nn.ModuleDict({name.replace(".", "_"): make() for name in scenes})
        if len(self.scenes) < len(scenes):
            raise ValueError(f"the scenes' names must differ by more than dots and underscores: {list(scenes)}")

    def forward(self, rows: Tensor, scene: Tensor) -> Tensor:
        """Rows ``[B, F]`` of scenes int64 ``[B]``, to ``[B, F']``."""
        layers = list(self.scenes.values())
        if len(layers) == 1:
            return layers[0](rows)
        sizes = torch.bincount(scene, minlength=len(layers)).tolist()
        order = torch.argsort(scene, stable=True)
        parts = rows.index_select(0, order).split(sizes)
        done = torch.cat([layer(part) for layer, part in zip(layers, parts, strict=True)])
        return done.index_select(0, torch.argsort(order))
