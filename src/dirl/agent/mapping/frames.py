"""A map of a first-person recording: its frames, what followed what, and shortcuts between frames of one place.

Unlike an `ImageGraph` it needs no grid of moves: turns are continuous, and only what lies ahead is seen. Two frames are
compared as cylinders, small and without slow changes of light, shifted against each other: how well the best shift fits
says whether both are of one place. Shortcuts are found as in SPTM (Savinov et al., ICLR 2018): a window of successive
frames must fit.
"""

from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from torch import Tensor

from dirl.agent.mapping.graph import MapError
from dirl.scenes.io.atomic import atomic_path

COLUMNS, ROWS = 48, 12
"""Of a frame as a cylinder."""

TALL = 0.45
"""Tangent of the elevation of its upper edge."""

ZOOMS = (1.0, 1.3, 1.7)
"""A photo is compared as if it had been taken nearer, too."""

SHIFTS = 20
"""Columns that frames are shifted at most."""

COARSE = 24, 6
"""Columns and rows for comparing all frames with all."""

TURNED = 3
"""Columns of these by which frames of one place may be turned."""

WINDOW = 3
"""Frames before and after that must fit too, for a shortcut."""

APART = 12
"""Frames between the ends of a shortcut, at least."""

ALIKE = 0.6
"""Mean correlation in the window, for a shortcut."""

KNOWN = 0.28
"""Least correlation of a frame with what is seen there."""

BATCH = 100


class FrameMap:
    """Frames of a recording and the paths between them.

    Args:
        frames: RGB, uint8 ``[N, H, W, 3]``, in order of time and near enough that neighbours overlap.
        field_of_view: of the camera from left to right, degrees.
        shortcuts: pairs of frames of one place, int ``[S, 2]``; they are looked for if left out.

    Raises:
        MapError: fewer than two frames, or not of that form.
    """

    def __init__(
        self, frames: NDArray[np.uint8], field_of_view: float = 90.0, shortcuts: NDArray[np.int64] | None = None
    ) -> None:
        if frames.dtype != np.uint8 or frames.ndim != 4 or frames.shape[-1] != 3 or len(frames) < 2:
            raise MapError(f"frames: expected two or more RGB frames, uint8 [N, H, W, 3], not {frames.shape}")
        self.frames, self.field_of_view = frames, field_of_view
        self.views = self.describe(frames)
        self.shortcuts = find_shortcuts(self.views) if shortcuts is None else shortcuts
        count = len(frames)
        first = np.concatenate([np.arange(count - 1), self.shortcuts[:, 0], self.shortcuts[:, 1]])
        second = np.concatenate([np.arange(1, count), self.shortcuts[:, 1], self.shortcuts[:, 0]])
        self._links = coo_array((np.ones(len(first)), (first, second)), shape=(count, count)).tocsr()

    def describe(self, frames: NDArray[np.uint8], zoom: float = 1.0) -> Tensor:
        """What is compared of frames, float32 ``[N, COLUMNS, 3 ROWS]``."""
        grid = _cylinder(self.field_of_view, zoom, frames.shape[1] / frames.shape[2])
        images = torch.from_numpy(np.require(frames, requirements="W"))
        return torch.cat([_local_contrast(part, grid) for part in images.split(BATCH)])

    def distances_to(self, goals: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Links on the shortest path to any of these frames, infinite if there is none, and the frame that follows."""
        far, following, _ = dijkstra(
            self._links.T, indices=goals, return_predecessors=True, min_only=True, unweighted=True
        )
        return far, following

    def save(self, file: str | Path) -> None:
        """Write the map, as an ``.npz`` file."""
        with atomic_path(Path(file)) as temporary, temporary.open("wb") as stream:
            np.savez_compressed(
                stream, frames=self.frames, shortcuts=self.shortcuts, field_of_view=np.float64(self.field_of_view)
            )


def load_frames_map(file: str | Path) -> FrameMap:
    """The map that was saved in a file.

    Raises:
        MapError: there is none, or it is damaged.
    """
    try:
        with Path(file).open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
            frames, shortcuts, angle = (stored[name] for name in ("frames", "shortcuts", "field_of_view"))
        inside = shortcuts.ndim == 2 and shortcuts.shape[1] == 2 and shortcuts.dtype == np.int64
        if not inside or (len(shortcuts) and not 0 <= shortcuts.min() <= shortcuts.max() < len(frames)):
            raise MapError(f"{file}: is a damaged map (shortcuts)")
        return FrameMap(frames, float(angle), shortcuts)
    except FileNotFoundError:
        raise MapError(f"{file}: there is no such map") from None
    except MapError:
        raise
    except Exception as error:  # whatever zip files and arrays raise when bytes are wrong
        raise MapError(f"{file}: is no map that can be read ({type(error).__name__})") from None


def find_shortcuts(views: Tensor) -> NDArray[np.int64]:
    """Pairs of frames of one place, of different times, in which `WINDOW` frames before and after fit too.

    They are int64 ``[S, 2]``, the earlier first: of described frames, ``[N, COLUMNS, 3 ROWS]``, the best one among
    neighbours for each.
    """
    turned = _turned(views)
    alike_by = torch.stack([turned[TURNED] @ one.T for one in turned]).amax(0)
    alike_by = torch.maximum(alike_by, alike_by.T)
    kernel = torch.eye(2 * WINDOW + 1)[None, None] / (2 * WINDOW + 1)
    smooth = F.conv2d(alike_by[None, None], kernel, padding=WINDOW)
    best = F.max_pool2d(smooth, (1, 2 * WINDOW + 1), 1, (0, WINDOW))  # of a frame, one among neighbours
    found = torch.nonzero(((smooth == best) & (smooth > ALIKE))[0, 0])
    return found[found[:, 1] - found[:, 0] >= APART].numpy()


def _turned(views: Tensor) -> Tensor:
    """The middle of described frames, coarser and normalised, turned by up to `TURNED` columns: ``[turns, N, D]``."""
    columns, rows = COARSE
    small = F.adaptive_avg_pool2d(views.unflatten(2, (3, ROWS)).permute(0, 2, 3, 1), (rows, columns))
    crops = [small[..., first : first + columns - 2 * TURNED].flatten(1) for first in range(2 * TURNED + 1)]
    return F.normalize(torch.stack(crops), dim=2)


def _cylinder(field_of_view: float, zoom: float, aspect: float) -> Tensor:
    """Where the points of the cylinder lie in a frame, as `torch.nn.functional.grid_sample` wants it."""
    half = np.tan(np.radians(field_of_view / 2))
    bearing = np.radians(((np.arange(COLUMNS) + 0.5) / COLUMNS - 0.5) * field_of_view / zoom)
    slope = np.linspace(-TALL, TALL, ROWS) / zoom
    across = np.broadcast_to(np.tan(bearing) / half, (ROWS, COLUMNS))
    along = slope[:, None] / np.cos(bearing) / (half * aspect)
    return torch.tensor(np.stack([across, along], -1), dtype=torch.float32)


def _local_contrast(frames: Tensor, grid: Tensor) -> Tensor:
    x = frames.permute(0, 3, 1, 2).float() / 255
    x = F.avg_pool2d(x, max(1, frames.shape[2] // 60))
    sampled = F.grid_sample(x, grid.expand(len(x), -1, -1, -1), padding_mode="border", align_corners=False)
    sampled = sampled - F.avg_pool2d(F.pad(sampled, (8, 8, 4, 4), mode="replicate"), (9, 17), 1)
    return sampled.permute(0, 3, 1, 2).flatten(2)


def _bands() -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """For each shift the pairs of columns that meet, the overlap in both frames, and its weight."""
    shift = torch.arange(-SHIFTS, SHIFTS + 1)
    seen, other = torch.meshgrid(torch.arange(COLUMNS), torch.arange(COLUMNS), indexing="ij")
    pairs = ((seen - other).flatten()[:, None] == shift).float()
    first, last = shift.clamp(min=0), COLUMNS + shift.clamp(max=0)
    return pairs, first, last, shift, ((COLUMNS - shift.abs()) / COLUMNS).sqrt()


PAIRS, FIRST, LAST, SHIFT, WEIGHT = _bands()


def _correlations(seen: Tensor, views: Tensor) -> Tensor:
    """Of one described frame with others, by shift, ``[B, 2 SHIFTS + 1]``."""
    product = torch.matmul(seen, views.transpose(1, 2)).flatten(1) @ PAIRS
    own = F.pad(seen.square().sum(-1).cumsum(0), (1, 0))
    others = F.pad(views.square().sum(-1).cumsum(1), (1, 0))
    norms = (own[LAST] - own[FIRST]) * (others[:, LAST - SHIFT] - others[:, FIRST - SHIFT])
    return product / norms.sqrt().clamp(min=1e-3) * WEIGHT


def fits(graph: FrameMap, photo: NDArray[np.uint8]) -> NDArray[np.float64]:
    """How well each frame of a map fits a photo, uint8 ``[H, W, 3]``; ``[N]``.

    It is the correlation at the best shift and zoom, less where little of both overlaps; 1 for the same frame.
    """
    seen = torch.cat([graph.describe(photo[None], zoom) for zoom in ZOOMS])
    return torch.stack([_correlations(one, graph.views) for one in seen]).amax((0, 2)).double().numpy()
