"""A recogniser that is learned from rooms in which every place was seen more than once."""

from pathlib import Path
from typing import Annotated, Self

import torch
import torch.nn.functional as F
from annotated_types import Interval
from torch import Tensor, nn

from dirl.perception.backbones.patches import FINE, PATCH_SHAPE, FinePatches, are_fine, coarse
from dirl.perception.backbones.principal import principal_components
from dirl.perception.recognition.recogniser import Thresholds
from dirl.scenes.io.files import read_weights

WEIGHTS = Path(__file__).parents[2] / "pretrained" / "general" / "recogniser.pt"
"""Weights of the agent `general`, for features and patches of EfficientNet-Lite0."""

ROWS, COLUMNS, VIEWS = 2, 4, 4
RING = COLUMNS * VIEWS
"""Columns of patches in the four views together: they lie around the agent, 22.5 degrees each."""

OFFSETS = 2
"""A column of the reference is compared with so many columns at either side of the seen one: 45 degrees."""

POOLED, WHITENED, PROJECTED = 128, 64, 48
"""Components of pooled features, those compared without training, and width of the learned projection of patches."""

WIDTH = ROWS * COLUMNS * (PROJECTED + WHITENED) + 2 * WHITENED
"""Of the description of a view by patches and pooled features."""

PANORAMA = WIDTH + POOLED
"""With what panoramas are compared by; what follows is the description of fine patches."""

SCALE = 4.0
"""Factor of the cosines, so that the layers on them learn as fast as the others."""

PAIRS_AT_ONCE = 4096

CHANNELS = PATCH_SHAPE[1]

PATCH_ROWS, PATCH_COLUMNS = 1, 2
"""A fine patch of a photo is compared with those of the view so far above, below and aside."""

PATCH_OFFSETS = (2 * PATCH_ROWS + 1) * (2 * PATCH_COLUMNS + 1)

BLANK = 0.92
"""Length of the mean of a view's patches, vectors of length one, above which it shows nothing. It is 0.95 to 0.99 of
images of one colour, with noise and without, and at most 0.89 of the 588 views of two built-in rooms."""


class Learned(nn.Module):
    """The log odds that two visits are of the same place and heading.

    The patches of the four views form a ring of columns around the agent. Each column of the reference is compared, by
    cosines, with the columns of the ring near it. Layers that are shared by all columns read the cosines, and
    convolutions over the columns how they go together: an error of heading shifts all columns alike, a step aside
    shifts those ahead and behind against each other. A single photo has four columns, which are compared with all of
    the ring. With fine patches (`dirl.perception.backbones.patches`) a photo is compared by `PhotoOdds` instead.

    Args:
        views: above these log odds four views are the goal's; see `Thresholds`.
        photo: above these log odds one view is the goal's.
        memory: above these log odds two visits are of the same place and heading.
        width: of the layers; weights have their own.
        dropout: of whitened features and patches, in training.
        weights: a file of `state_dict`; those of the agent `general` if left out, none with ``""``.

    Raises:
        ValueError: the file of weights cannot be read, or is of another network.
    """

    reads_patches = True
    calibrated = True

    def __init__(
        self,
        views: float = 4.0,
        photo: float = 4.0,
        memory: float = 2.0,
        width: Annotated[int, Interval(ge=1, le=4096)] = 64,
        dropout: Annotated[float, Interval(ge=0, le=0.9)] = 0.25,
        weights: str | None = None,
    ) -> None:
        super().__init__()
        self.thresholds = Thresholds(views, photo, memory)
        stored = {} if weights == "" else read_weights(Path(weights or WEIGHTS))
        width = len(stored.get("column.bias", range(width)))
        features = len(stored.get("mean", ()))
        self.register_buffer("mean", torch.zeros(features))
        self.register_buffer("axes", torch.zeros(features, POOLED))
        self.register_buffer("patch_mean", torch.zeros(CHANNELS))
        self.register_buffer("patch_axes", torch.zeros(CHANNELS, CHANNELS))
        self.register_buffer("calibration", torch.tensor([[1.0, 0.0], [1.0, 0.0]]))
        self.dropout = nn.Dropout(dropout)
        self.patch = nn.Linear(CHANNELS, PROJECTED, bias=False)
        self.view = nn.Linear(POOLED, WHITENED, bias=False)
        self.column = nn.Linear((2 * OFFSETS + 1) * ROWS * ROWS * 2 + 2, width)
        self.near = nn.ModuleList(nn.Conv1d(width, width, 3) for _ in range(2))
        self.odds = nn.ModuleList(
            nn.Sequential(nn.Linear(2 * width + 1, 64), nn.ReLU(), nn.Linear(64, 1)) for _ in ("photo", "views")
        )
        self.photo = PhotoOdds()
        if stored:
            try:
                self.load_state_dict(stored)
            except (RuntimeError, TypeError, AttributeError) as error:
                reason = " ".join(str(error).split())[:300]
                raise ValueError(f"{weights}: are weights of another network: {reason}") from None
            self.eval()

    mean: Tensor
    axes: Tensor
    patch_mean: Tensor
    patch_axes: Tensor
    calibration: Tensor
    """Slope and intercept for a photo, and for four views, float32 ``[2, 2]``: the network is too sure in new rooms."""

    @property
    def trained(self) -> bool:
        """Whether there are weights to compare visits with."""
        return bool(self.axes.any())

    def fit(self, features: Tensor, patches: Tensor | None = None) -> Self:
        """Return itself: it was trained for unseen places."""
        return self

    def measure(self, features: Tensor, patches: Tensor) -> None:
        """Whiten by N views of training rooms: pooled features, float ``[N, D]``, and patches, ``[N, cells, 96]``."""
        self.mean, axes = principal_components(features.float(), POOLED)
        self.axes = F.pad(axes, (0, POOLED - axes.shape[1]))
        self.patch_mean, self.patch_axes = principal_components(coarse(patches).flatten(0, 1).float(), CHANNELS)
        if are_fine(patches):
            self.photo.measure(patches)

    def describe(self, features: Tensor, patches: Tensor | None = None) -> Tensor:
        """Return patches and pooled features, whitened and projected, each of length one; see `Recogniser.describe`."""
        known = patches is not None and (are_fine(patches) or patches.shape[-2] == ROWS * COLUMNS)
        if patches is None or not known or features.shape[-1] != len(self.mean) or patches.shape[-1] != CHANNELS:
            raise ValueError(
                f"recogniser=learned compares 8 or 48 patches and {len(self.mean)} features a view, and these views "
                "have others: encode them with encoder=efficientnet_lite0 fine_patches=true, or use recogniser=ncc"
            )
        pooled, whitened = self.whiten(features, patches)
        parts = [self.project(pooled, whitened), pooled / self.axes.norm(dim=0).clamp(min=1e-6)]
        if are_fine(patches) and self.photo.trained:
            parts.append(self.photo.describe(patches))
        return torch.cat(parts, -1)

    def whiten(self, features: Tensor, patches: Tensor) -> tuple[Tensor, Tensor]:
        """Whiten pooled features and patches by training rooms, to ``[..., 128]`` and ``[..., 8, 96]``."""
        return (features.float() - self.mean) @ self.axes, (coarse(patches).float() - self.patch_mean) @ self.patch_axes

    def project(self, pooled: Tensor, patches: Tensor) -> Tensor:
        """Return the description of whitened features and patches, float32 ``[..., F]``; see `describe`."""
        # Rows of patches become columns: [..., 4 columns, 2 rows, channels].
        parts = self.dropout(patches).unflatten(-2, (ROWS, COLUMNS)).transpose(-3, -2)
        pooled = self.dropout(pooled)
        described = (self.patch(parts), parts[..., :WHITENED], self.view(pooled), pooled[..., :WHITENED])
        lengths = [F.normalize(part, dim=-1) for part in described]
        return torch.cat([part.flatten(-3) for part in lengths[:2]] + lengths[2:], -1)

    def whole(self, described: Tensor) -> Tensor:
        """Return principal components of pooled features, not whitened, ``[..., 128]``; see `ComparesPanoramas`."""
        return described[..., WIDTH:PANORAMA]

    def scores(self, seen: Tensor, references: Tensor) -> Tensor:
        """Return the log odds of every two; see `Recogniser.scores`."""
        rows = max(1, PAIRS_AT_ONCE // references.shape[-3])
        if references.shape[-2] == 1 and min(seen.shape[-1], references.shape[-1]) > PANORAMA:
            photos = references[..., 0, PANORAMA:]
            return torch.cat([self.photo.scores(part[..., PANORAMA:], photos) for part in seen.split(rows, -3)], -2)
        blocks = [self.log_odds(part.unsqueeze(-3), references.unsqueeze(-4)) for part in seen.split(rows, -3)]
        return torch.cat(blocks, -2)

    def log_odds(self, seen: Tensor, reference: Tensor) -> Tensor:
        """Return log odds, ``[...]``, of visits, float32 ``[..., 4, F]``, and references ``[..., V, F]``, broadcast."""
        several = int(reference.shape[-2] > 1)
        slope, intercept = self.calibration[several]
        return slope * self.of_columns(self.compare(seen, reference)) + intercept

    def compare(self, seen: Tensor, reference: Tensor) -> Tensor:
        """Return cosines of each column of the reference, float32 ``[..., 4 V, features]``; see `log_odds`."""
        ring, columns = _parts(seen), _parts(reference)
        count = columns[0].shape[-3]
        near = torch.arange(count)[:, None] + torch.arange(-OFFSETS, OFFSETS + 1)
        near = near.to(seen.device)
        parts = []
        for around, ahead in zip(ring[:2], columns[:2], strict=True):
            cosines = torch.einsum("...iaw,...kbw->...kiab", around, ahead)
            index = (near % RING)[..., None, None].expand(*cosines.shape[:-3], near.shape[1], ROWS, ROWS)
            parts.append(cosines.gather(-3, index).flatten(-3))
        whole = [(a[..., : count // COLUMNS, :] * b).sum(-1) for a, b in zip(ring[2:], columns[2:], strict=True)]
        parts.append(torch.stack(whole, -1).repeat_interleave(COLUMNS, -2))
        return SCALE * torch.cat(parts, -1)

    def of_columns(self, compared: Tensor) -> Tensor:
        """Return the log odds by the cosines of four columns, a photo's, or of sixteen; see `compare`."""
        several = int(compared.shape[-2] == RING)
        read = F.relu(self.column(compared))
        read = read.reshape(-1, *read.shape[-2:]).transpose(1, 2)
        for layer in self.near:
            read = read + F.relu(layer(F.pad(read, (1, 1), mode="circular" if several else "constant")))
        whole = compared[..., -2:].mean((-1, -2)).flatten().unsqueeze(-1)
        odds = self.odds[several](torch.cat([read.mean(-1), read.amax(-1), whole], -1))
        return odds.view(compared.shape[:-2])


class PhotoOdds(FinePatches):
    """Compares each fine patch of a photo with those of the view ahead that are near its place in the picture.

    A step ahead moves patches away from the middle, an error of heading moves all alike. Convolutions over the cells
    read the cosines at all offsets, and so which of them moved where. The view goes on into those to the left and to
    the right.
    """

    def __init__(self, width: int = 48) -> None:
        super().__init__(dropout=0.2)
        self.register_buffer("calibration", torch.tensor([1.0, 0.0]))
        self.cosines = nn.Conv2d(2 * PATCH_OFFSETS, width, 1)
        self.near = nn.ModuleList(nn.Conv2d(width, width, 3, padding=1) for _ in range(2))
        self.odds = nn.Sequential(nn.Linear(2 * width, 64), nn.ReLU(), nn.Linear(64, 1))

    calibration: Tensor
    """Slope and intercept of the log odds, float32 ``[2]``."""

    @property
    def trained(self) -> bool:
        """Whether there are weights to compare photos with."""
        return bool(self.mean.any())

    def describe(self, patches: Tensor) -> Tensor:
        """Return two vectors of length one a cell, float ``[..., cells, 96]`` to float32 ``[..., cells * 64]``."""
        standard = self.standardised(patches)
        parts = self.patch(self.dropout(standard)), standard[..., : self.kept]
        return torch.cat([F.normalize(part, dim=-1) for part in parts], -1).flatten(-2)

    def scores(self, seen: Tensor, photos: Tensor) -> Tensor:
        """Return the log odds of visits, ``[..., A, 4, F]``, with photos, ``[..., B, F]``; ``[..., A, B]``.

        They are minus infinity where the view ahead shows nothing, as of a camera that is covered or dead.
        """
        ahead = seen[..., 0, :].unflatten(-1, (*FINE, -1))[..., self.projected :]
        ahead = ahead[..., 1:-1, 1:-1, :]  # at its edges patches differ
        blank = ahead.mean((-3, -2)).norm(dim=-1) > BLANK
        around, photos = self._windows(seen), photos.unflatten(-1, (FINE[0] * FINE[1], -1))
        cosines = []
        for part in (slice(self.projected), slice(self.projected, None)):
            cosines.append(torch.einsum("...aocw,...bcw->...aboc", around[..., part], photos[..., part]))
        compared = SCALE * torch.cat(cosines, -2)
        slope, intercept = self.calibration
        odds = slope * self._read(compared.flatten(0, -3)).view(compared.shape[:-2]) + intercept
        return odds.masked_fill(blank[..., None], -torch.inf)

    def _windows(self, seen: Tensor) -> Tensor:
        """Return the patches near each cell of the view ahead, of ``[..., 4, F]``: ``[..., offsets, 48, W]``."""
        ahead, right, _, left = seen.unflatten(-1, (*FINE, -1)).unbind(-4)
        wide = torch.cat([left[..., -PATCH_COLUMNS:, :], ahead, right[..., :PATCH_COLUMNS, :]], -2)
        wide = F.pad(wide, (0, 0, 0, 0, PATCH_ROWS, PATCH_ROWS))
        rows, columns = range(2 * PATCH_ROWS + 1), range(2 * PATCH_COLUMNS + 1)
        moved = [wide[..., y : y + FINE[0], x : x + FINE[1], :].flatten(-3, -2) for y in rows for x in columns]
        return torch.stack(moved, -3)

    def _read(self, compared: Tensor) -> Tensor:
        """Return the log odds by the cosines of a pair, float32 ``[P, 2 * offsets, 48]`` to ``[P]``."""
        read = F.relu(self.cosines(compared.unflatten(-1, FINE)))
        for layer in self.near:
            read = read + F.relu(layer(read))
        return self.odds(torch.cat([read.mean((2, 3)), read.amax((2, 3))], 1)).squeeze(1)


def _parts(described: Tensor) -> tuple[Tensor, ...]:
    """Split V views, ``[..., V, F]``, into two kinds of columns, ``[..., 4 V, 2, W]``, and views, ``[..., V, W]``."""
    sizes = (ROWS * COLUMNS * PROJECTED, ROWS * COLUMNS * WHITENED, WHITENED, WHITENED)
    projected, whitened, *views = described[..., :WIDTH].split(sizes, -1)
    columns = (part.unflatten(-1, (COLUMNS, ROWS, -1)).flatten(-4, -3) for part in (projected, whitened))
    return *columns, *views
