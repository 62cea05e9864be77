"""Patch features: features of the parts of a view, for agents that compare views part by part.

The third stage of the shipped ResNet-50, of views at 96x128 pixels, is averaged over 2 x 4 cells and projected from
1024 to 96 channels of about unit variance. The projection, principal components of training rooms, is the same for
every room, so that patches of different rooms are comparable; see ``data/NOTICE.md``. EfficientNet-Lite0 has patches of
its own, and fine ones: 6 x 8 cells, whose means are the others (`coarse`).
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dirl.scenes.io.files import file_digest

PATCH_SIZE = (96, 128)
"""Height and width that views are resized to, pixels."""

CELLS, FINE = (2, 4), (6, 8)
"""Rows and columns, and those of fine patches."""

PATCH_SHAPE, FINE_SHAPE = (CELLS[0] * CELLS[1], 96), (FINE[0] * FINE[1], 96)
"""Patches of a view, and channels of a patch; and those of fine patches."""

PROJECTION = Path(__file__).parent / "data" / "patch_projection.pth"


def load_projection(
    device: str | torch.device, file: Path = PROJECTION, cells: tuple[int, int] = CELLS
) -> Callable[[Tensor], Tensor]:
    """Load a shipped projection of an inner stage's map, ``[B, C, H, W]``, to patches, float32 ``[B, cells, 96]``.

    C is 1024 for the ResNet-50. Cells are numbered row by row, from the upper left.
    """
    stored = torch.load(file, map_location=device, weights_only=True)
    mean, components = stored["mean"].float(), stored["components"].float()
    return partial(_projected, mean, components, cells)


def _projected(mean: Tensor, components: Tensor, cells: tuple[int, int], third_stage: Tensor) -> Tensor:
    return (cells_of(third_stage, cells) - mean) @ components


def cells_of(stage: Tensor, cells: tuple[int, int] = CELLS) -> Tensor:
    """Return the means over equal cells of a map, ``[B, C, H, W]``, as float32 ``[B, cells, C]``.

    A cell may have parts of the map's pixels, so that the means of fine cells are those of the others in any map.
    """
    stage, (rows, columns) = stage.float(), cells
    if stage.shape[-2] % rows == 0 and stage.shape[-1] % columns == 0:
        return F.adaptive_avg_pool2d(stage, cells).flatten(2).transpose(1, 2)
    down, across = (_shares(*lengths).to(stage) for lengths in zip(stage.shape[-2:], cells, strict=True))
    return torch.einsum("ri,bcij,sj->brsc", down, stage, across).flatten(1, 2)


def _shares(length: int, parts: int) -> Tensor:
    """Return how much each of ``length`` pixels contributes to the mean of each equal part, ``[parts, length]``."""
    edges, pixels = torch.arange(parts + 1) * length / parts, torch.arange(length)
    overlap = torch.minimum(edges[1:, None], pixels + 1) - torch.maximum(edges[:-1, None], pixels)
    return overlap.clamp(min=0) * parts / length


def are_fine(patches: Tensor) -> bool:
    """Return True if patches ``[..., cells, channels]`` are of `FINE` cells."""
    return patches.shape[-2] == FINE_SHAPE[0]


def coarse(patches: Tensor) -> Tensor:
    """Return patches of `CELLS`, ``[..., cells, channels]``: the means of fine ones; others as they are."""
    if not are_fine(patches):
        return patches
    (rows, columns), (high, wide) = CELLS, (fine // few for fine, few in zip(FINE, CELLS, strict=True))
    cells = patches.unflatten(-2, (rows, high, columns, wide))
    return cells.float().mean((-4, -2)).flatten(-3, -2).to(patches.dtype)


class FinePatches(nn.Module):
    """What compares fine patches: it standardises them by those of training rooms, and has a projection of each."""

    kept, projected = 32, 32
    """Channels of a patch that are compared as they are, and width of its projection."""

    def __init__(self, dropout: float) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(FINE_SHAPE[1]))
        self.register_buffer("std", torch.ones(FINE_SHAPE[1]))
        self.dropout = nn.Dropout(dropout)
        self.patch = nn.Linear(FINE_SHAPE[1], self.projected, bias=False)

    mean: Tensor
    std: Tensor
    """Mean and deviation of fine patches in training rooms; 0 and 1 before the training."""

    def measure(self, patches: Tensor) -> None:
        """Standardise by the patches of training rooms, float ``[N, 48, 96]``."""
        cells = patches.flatten(0, 1).float()
        self.mean, self.std = cells.mean(0), cells.std(0)

    def standardised(self, patches: Tensor) -> Tensor:
        """Return patches with mean 0 and deviation 1, float32 ``[..., 48, 96]``."""
        return (patches.float() - self.mean) / self.std


def patch_attributes() -> dict[str, str]:
    """Return the attributes that a dump stores with patches of the shipped ResNet-50."""
    height, width = PATCH_SIZE
    return {
        "extractor": f"ResNet-50 as shipped, third stage, views at {height}x{width}, {CELLS[0]}x{CELLS[1]} cells",
        "projection": f"sha256:{file_digest(PROJECTION)}",
    }
