"""Patch features: features of the parts of a view, for agents that compare views part by part.

The third stage of the shipped ResNet-50, of views at 96x128 pixels, is averaged over 2 x 4 cells and projected from
1024 to 96 channels of about unit variance. The projection, principal components of training rooms, is the same for
every room, so that patches of different rooms are comparable; see ``data/NOTICE.md``.
"""

import hashlib
from collections.abc import Callable
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor

PATCH_SIZE = (96, 128)
"""Height and width that views are resized to, pixels."""

CELLS = (2, 4)
"""Rows and columns."""

PATCH_SHAPE = (CELLS[0] * CELLS[1], 96)
"""Patches of a view, and channels of a patch."""

PROJECTION = Path(__file__).parent / "data" / "patch_projection.pth"


def load_projection(device: str | torch.device = "cpu", file: Path = PROJECTION) -> Callable[[Tensor], Tensor]:
    """A shipped projection: an inner stage's map, ``[B, C, H, W]`` (C = 1024), to patches, float32 ``[B, cells, 96]``.

    Cells are numbered row by row, from the upper left.
    """
    stored = torch.load(file, map_location=device, weights_only=True)
    mean, components = stored["mean"].float(), stored["components"].float()

    def project(third_stage: Tensor) -> Tensor:
        return (cells_of(third_stage) - mean) @ components

    return project


def cells_of(third_stage: Tensor) -> Tensor:
    """The means over cells of a map, ``[B, C, H, W]``, float32 ``[B, cells, C]``."""
    return F.adaptive_avg_pool2d(third_stage.float(), CELLS).flatten(2).transpose(1, 2)


def patch_attributes() -> dict[str, str]:
    """The attributes that a dump stores with patches of the shipped ResNet-50."""
    height, width = PATCH_SIZE
    return {
        "extractor": f"ResNet-50 as shipped, third stage, views at {height}x{width}, {CELLS[0]}x{CELLS[1]} cells",
        "projection": projection_hash(PROJECTION),
    }


def projection_hash(file: Path) -> str:
    """``sha256:`` and 64 digits, of a file."""
    return f"sha256:{hashlib.sha256(file.read_bytes()).hexdigest()}"
