"""The log odds that a view is of the same place and heading as a single photo, by fine patches."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dirl.perception.backbones.patches import FINE, PATCH_SHAPE

CHANNELS = PATCH_SHAPE[1]

KEPT, PROJECTED = 32, 32
"""Channels of a patch that are compared as they are, and width of the learned projection."""

NEAR_ROWS, NEAR_COLUMNS = 1, 2
"""A patch of the photo is compared with those of the view so far above, below and aside."""

OFFSETS = (2 * NEAR_ROWS + 1) * (2 * NEAR_COLUMNS + 1)

SCALE = 4.0
"""Factor of the cosines, so that the layers on them learn as fast as the others."""

BLANK = 0.92
"""Length of the mean of a view's patches, vectors of length one, above which it shows nothing. It is 0.95 to 0.99 of
images of one colour, with noise and without, and at most 0.89 of the 588 views of two built-in rooms."""


class PhotoOdds(nn.Module):
    """Compares each fine patch of a photo with those of the view ahead that are near its place in the picture.

    A step ahead moves patches away from the middle, an error of heading moves all alike. Convolutions over the cells
    read the cosines at all offsets, and so which of them moved where. The view goes on into those to the left and to
    the right.

    Args:
        width: of the convolutions.
        dropout: of patches, in training.
    """

    def __init__(self, width: int = 48, dropout: float = 0.2) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(CHANNELS))
        self.register_buffer("std", torch.zeros(CHANNELS))
        self.register_buffer("calibration", torch.tensor([1.0, 0.0]))
        self.dropout = nn.Dropout(dropout)
        self.patch = nn.Linear(CHANNELS, PROJECTED, bias=False)
        self.cosines = nn.Conv2d(2 * OFFSETS, width, 1)
        self.near = nn.ModuleList(nn.Conv2d(width, width, 3, padding=1) for _ in range(2))
        self.odds = nn.Sequential(nn.Linear(2 * width, 64), nn.ReLU(), nn.Linear(64, 1))

    mean: Tensor
    std: Tensor
    """Mean and deviation of fine patches in training rooms; zeros before the training."""
    calibration: Tensor
    """Slope and intercept of the log odds, float32 ``[2]``."""

    @property
    def trained(self) -> bool:
        """Whether there are weights to compare photos with."""
        return bool(self.std.any())

    def measure(self, patches: Tensor) -> None:
        """Standardise by those of training rooms, float ``[N, 48, 96]``."""
        cells = patches.flatten(0, 1).float()
        self.mean, self.std = cells.mean(0), cells.std(0)

    def describe(self, patches: Tensor) -> Tensor:
        """Return two vectors of length one a cell, float ``[..., cells, 96]`` to float32 ``[..., cells * 64]``."""
        standard = (patches.float() - self.mean) / self.std
        parts = self.patch(self.dropout(standard)), standard[..., :KEPT]
        return torch.cat([F.normalize(part, dim=-1) for part in parts], -1).flatten(-2)

    def scores(self, seen: Tensor, photos: Tensor) -> Tensor:
        """Return the log odds of visits, ``[..., A, 4, F]``, with photos, ``[..., B, F]``; ``[..., A, B]``.

        They are minus infinity where the view ahead shows nothing, as of a camera that is covered or dead.
        """
        ahead = seen[..., 0, :].unflatten(-1, (*FINE, -1))[..., 1:-1, 1:-1, PROJECTED:]  # at its edges patches differ
        blank = ahead.mean((-3, -2)).norm(dim=-1) > BLANK
        around, photos = self._windows(seen), photos.unflatten(-1, (FINE[0] * FINE[1], -1))
        cosines = []
        for part in (slice(PROJECTED), slice(PROJECTED, None)):
            cosines.append(torch.einsum("...aocw,...bcw->...aboc", around[..., part], photos[..., part]))
        compared = SCALE * torch.cat(cosines, -2)
        slope, intercept = self.calibration
        odds = slope * self._read(compared.flatten(0, -3)).view(compared.shape[:-2]) + intercept
        return odds.masked_fill(blank[..., None], -torch.inf)

    def _windows(self, seen: Tensor) -> Tensor:
        """Return the patches near each cell of the view ahead, of ``[..., 4, F]``: ``[..., offsets, 48, W]``."""
        ahead, right, _, left = seen.unflatten(-1, (*FINE, -1)).unbind(-4)
        wide = torch.cat([left[..., -NEAR_COLUMNS:, :], ahead, right[..., :NEAR_COLUMNS, :]], -2)
        wide = F.pad(wide, (0, 0, 0, 0, NEAR_ROWS, NEAR_ROWS))
        rows, columns = range(2 * NEAR_ROWS + 1), range(2 * NEAR_COLUMNS + 1)
        moved = [wide[..., y : y + FINE[0], x : x + FINE[1], :].flatten(-3, -2) for y in rows for x in columns]
        return torch.stack(moved, -3)

    def _read(self, compared: Tensor) -> Tensor:
        """Return the log odds by the cosines of a pair, float32 ``[P, 2 * offsets, 48]`` to ``[P]``."""
        read = F.relu(self.cosines(compared.unflatten(-1, FINE)))
        for layer in self.near:
            read = read + F.relu(layer(read))
        return self.odds(torch.cat([read.mean((2, 3)), read.amax((2, 3))], 1)).squeeze(1)
