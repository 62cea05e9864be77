"""Two frames compared by their columns: how well they fit, and where one was taken, seen from the other.

A network describes each of 40 columns of a frame, and says how far away the wall in it stands. Columns of two frames
that are each other's best match are points of one wall; the rigid motion that lays these points on each other is where
the other frame was taken. Nothing of it knows a place: it is trained in mazes with other walls.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor, nn

from dirl.perception.matching import SCALE, Described, Fit, Motion
from dirl.scenes.io.files import read_weights

COLUMNS = 40

WEIGHTS = Path(__file__).parent / "columns.pt"
"""Trained by examples/train_columns.py."""

WIDTH, HEIGHT = 80, 60
"""What the network reads, of a field of view of 90 degrees from left to right."""

BEARING = torch.atan((torch.arange(COLUMNS) + 0.5) / COLUMNS * 2 - 1)
"""Direction of each column, to the right, radians."""

UNIT = 100.0
"""Distances in the network are in so many units of the map."""

ROUNDS, TOLERANCE = 4, 0.2
"""Rounds of weighing matches by how well they agree, and the distance that halves a weight in the last."""


LIKE, LEAST = 0.39, 0.15
"""The likeness of frames whose columns match in x places is LIKE * log(x + LEAST)."""

LIKELY, SAMPLE = 60, 40
"""Number of likely frames that are compared with a view, and of others, whose median likeness all others get."""


class ColumnNet(nn.Module):
    """Columns of frames as vectors, and the depth in each; 126,000 parameters. A `FrameMatcher`."""

    kind = "columns"

    def __init__(self) -> None:
        super().__init__()
        self.trunk = nn.Sequential(
            _convolution(nn.Conv2d(3, 24, 5, (3, 2), 2, bias=False)),
            _convolution(nn.Conv2d(24, 32, 3, (2, 1), 1, bias=False)),
            _convolution(nn.Conv2d(32, 48, 3, (2, 1), 1, bias=False)),
        )
        self.along = nn.Sequential(
            _convolution(nn.Conv1d(240, 96, 3, padding=1, bias=False)),
            _convolution(nn.Conv1d(96, 96, 3, padding=1, bias=False)),
        )
        self.look = nn.Sequential(nn.Conv1d(96, 64, 1, bias=False), nn.BatchNorm1d(64, affine=False))
        self.depth = nn.Conv1d(96, 1, 1)
        self.sharp = nn.Parameter(torch.tensor(2.3))
        self.none = nn.Parameter(torch.tensor(3.0))

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Return vectors of unit length, ``[N, C, COLUMNS]``, and the logarithm of depths, ``[N, COLUMNS]``.

        The images are RGB, float32 ``[N, 3, HEIGHT, WIDTH]``, -0.5 to 0.5.
        """
        columns = self.along(self.trunk(images).flatten(1, 2))
        return F.normalize(self.look(columns), dim=1), self.depth(columns)[:, 0]

    @torch.no_grad()
    def describe(self, views: Iterable[NDArray[np.uint8]]) -> Described:
        """Describe frames, RGB, uint8 ``[H, W, 3]`` each, of 90 degrees from left to right.

        Their points are those of walls, one in each column, ahead and to the right of the camera; there is no
        description of the whole.
        """
        vectors, depth = self(images_of(np.stack(list(views))))
        scaled = (vectors.mT * SCALE).round().clamp(-127, 127).to(torch.int8)
        count = len(scaled)
        whole, counts = np.zeros((count, 0), np.float16), np.full(count, COLUMNS, np.int16)
        return Described(whole, wall_points(depth).numpy().astype(np.float16), scaled.numpy(), counts)

    @torch.no_grad()
    def likeness(
        self, seen: Described, frames: Described, likely: NDArray[np.float64] | None = None
    ) -> NDArray[np.float64]:
        """Return how many columns of one view match those of each frame, as a logarithm, ``[N]``."""
        some = every = np.arange(len(frames))
        usual = every[:0]
        if likely is not None and len(frames) > LIKELY:
            usual = every[:: max(1, len(frames) // SAMPLE)]
            some = np.unique(np.argpartition(-likely, LIKELY)[:LIKELY] // 2 * 2)
        matched = self._matches_with(seen, frames, np.concatenate([usual, some])).amax(2).sum(1).numpy()
        if len(usual):
            counts = np.full(len(frames) + 1, np.median(matched[: len(usual)]))
            counts[some] = counts[some + 1] = matched[len(usual) :]  # the frame behind is as alike
            matched = counts[:-1]
        return np.asarray(LIKE * np.log(matched + LEAST))

    @torch.no_grad()
    def fit(self, seen: Described, frames: Described, some: Sequence[int]) -> Fit:
        """Return how some of the frames fit one view, and where they were taken."""
        matches = self._matches_with(seen, frames, some)
        here, there = (torch.from_numpy(of).float() for of in (seen.positions[:1], frames.positions[some]))
        return Fit(*(value.numpy() for value in relative_pose(matches, here.expand_as(there), there)))

    def motion(
        self, seen: Described, frames: Described, frame: int, size: tuple[int, int], field_of_view: float
    ) -> Motion | None:
        """Return the motion to a frame; the field of view is that of the training."""
        fit = self.fit(seen, frames, [frame])
        return Motion(float(fit.ahead[0]), float(fit.right[0]), float(fit.turned[0]))

    def _matches_with(self, seen: Described, frames: Described, some: Sequence[int] | NDArray[np.int64]) -> Tensor:
        """Return probabilities that columns of one view and of some frames match, ``[S, COLUMNS, COLUMNS]``.

        By row times by column, beside the logit `none` of no match.
        """
        here, there = (torch.from_numpy(of).float() for of in (seen.vectors[0], frames.vectors[some]))
        # One product of two matrices takes half the time of a product for each frame.
        logits = there.flatten(0, 1) @ (here.T * self.sharp.exp() / SCALE**2)
        alike, none = logits.view(len(there), COLUMNS, COLUMNS).mT.exp(), self.none.exp()
        return alike.square() / (alike.sum(2, keepdim=True) + none) / (alike.sum(1, keepdim=True) + none)


def load_column_net() -> ColumnNet:
    """Load the network with the weights of the package."""
    net = ColumnNet()
    net.load_state_dict(read_weights(WEIGHTS))
    return net.eval()


def images_of(frames: NDArray[np.uint8]) -> Tensor:
    """Return `ColumnNet`'s input, float32 ``[N, 3, HEIGHT, WIDTH]``, of frames, uint8 ``[N, H, W, 3]``."""
    images = torch.from_numpy(np.ascontiguousarray(frames)).permute(0, 3, 1, 2).float()
    if images.shape[2:] != (HEIGHT, WIDTH):
        images = F.interpolate(images, (HEIGHT, WIDTH), mode="area")
    return (images / 255 - 0.5).contiguous(memory_format=torch.channels_last)


def wall_points(depth: Tensor) -> Tensor:
    """Return the walls' points, ahead and to the right, ``[N, COLUMNS, 2]``, of the logarithm of depths."""
    distance = depth.clamp(-2.5, 3.0).exp()
    return torch.stack([distance * BEARING.cos(), distance * BEARING.sin()], -1)


def relative_pose(matches: Tensor, seen: Tensor, other: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return the rigid motion that lays matched points on each other, in the order of `Fit`.

    Weighted least squares in closed form; then matches that do not agree weigh less, and so on for `ROUNDS`. Matches
    are probabilities, ``[N, COLUMNS, COLUMNS]``; the points are those of the frame that is seen and of the other,
    ``[N, COLUMNS, 2]`` each.
    """
    matched, best = matches.max(2)
    other = other.gather(1, best[..., None].expand(-1, -1, 2))
    size = TOLERANCE * (0.5 + 0.5 * seen.norm(dim=-1))
    weight = matched
    for left in reversed(range(ROUNDS)):
        total = weight.sum(1, keepdim=True).clamp(min=1e-6)
        middle, other_middle = ((weight[..., None] * points).sum(1) / total for points in (seen, other))
        here, there = seen - middle[:, None], (other - other_middle[:, None]) * weight[..., None]
        cross = here[..., 1] * there[..., 0] - here[..., 0] * there[..., 1]
        angle = torch.atan2(cross.sum(1), (here * there).sum((1, 2)))
        place = middle - _rotated(other_middle[:, None], angle)[:, 0]
        off = (seen - _rotated(other, angle) - place[:, None]).norm(dim=-1) / size / 2**left
        weight = matched / (1 + off**2) ** 2
    return weight.sum(1), place[:, 0] * UNIT, place[:, 1] * UNIT, -torch.rad2deg(angle)


def _rotated(points: Tensor, angle: Tensor) -> Tensor:
    cos, sin = angle.cos()[:, None], angle.sin()[:, None]
    ahead, right = points.unbind(-1)
    return torch.stack([cos * ahead - sin * right, sin * ahead + cos * right], -1)


def _convolution(layer: nn.Conv1d | nn.Conv2d) -> nn.Sequential:
    norm = nn.BatchNorm2d if isinstance(layer, nn.Conv2d) else nn.BatchNorm1d
    return nn.Sequential(layer, norm(layer.out_channels), nn.ReLU(inplace=True))
