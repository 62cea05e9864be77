"""Whether a panorama shows what a photo of another camera shows: the rotation on which matched points agree.

`Learned` compares what is where in two pictures, and another focal length or direction moves everything. Seen from one
place, however, the points of two pictures differ by a single rotation, whatever the cameras. From another place near
things move against far ones, and fewer points agree.
"""

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from dirl.perception.matching import angles, mutual, xfeat

VIEW, FIELD_OF_VIEW = 320, 75.0
"""Pixels that a view is made wide, and its horizontal field of view, degrees."""

PHOTO = 256, 330
"""Pixels that the longer side of a photo is made: XFeat matches what is about equally large, and the photo's focal
length is unknown."""

FOCAL = 0.6, 0.65, 0.7, 0.76, 0.82, 0.89
"""Focal lengths of a photo that are tried, in lengths of its longer side: 80 to 59 degrees. Beyond, a photo taken here
looks like one that was taken a step ahead."""

FEW = 60
"""A photo with fewer points tells nothing by them: it shows a blank wall, or is too small."""

LIKELY = 2
"""Views that are compared, the most alike as a whole."""

ALIKE = 0.75
"""Least cosine of the vectors of two points."""

MATCHES = 160
"""Of two pictures, at most, the clearest."""

TOLERANCE = 0.02
"""Radians within which points agree."""

WEIGHT, NONE, LEAST = 3.0, 11.0, -4.0
"""Log odds are ``WEIGHT * log(1 + points) - NONE``, at least `LEAST`; chosen on real tours, see docs/decisions.md."""


class PhotoPoints:
    """The points of one photo, RGB, uint8 ``[H, W, 3]``, found by XFeat (``pip install 'dirl[match]'``)."""

    def __init__(self, photo: NDArray[np.uint8]) -> None:
        longer = max(photo.shape[:2])
        parts = [_points(_resized(photo, side / longer), side) for side in PHOTO]
        self.places, self.vectors = torch.cat([part[0] for part in parts]), torch.cat([part[1] for part in parts])

    def log_odds(self, views: NDArray[np.uint8], likeness: Tensor) -> Tensor:
        """Return how much points speak for the photo having been taken here, facing each view of a panorama.

        Args:
            views: K views, clockwise, RGB, uint8 ``[K, H, W, 3]``.
            likeness: of each view as a whole to the photo, float32 ``[K]``.

        Returns:
            Log odds, float32 ``[K]``, to be added to those of a recogniser.
        """
        turns = len(views)
        most = torch.zeros(turns)
        if len(self.places) < FEW:
            return most
        for view in likeness.topk(LIKELY).indices.tolist():
            agree, yaw = self._agree(views[view])
            facing = (view + round(yaw / (360 / turns))) % turns
            most[facing] = max(float(most[facing]), agree)
        return (WEIGHT * most.log1p() - NONE).clamp(min=LEAST)

    def _agree(self, view: NDArray[np.uint8]) -> tuple[float, float]:
        """Return how many points agree on a rotation, and how far right of the view's middle the photo's then is."""
        there, vectors = _points(_resized(view, VIEW / view.shape[1]), VIEW)
        if not len(there):
            return 0.0, 0.0
        alike = self.vectors @ vectors.T
        first, second = mutual(alike, ALIKE)
        if not len(first):
            return 0.0, 0.0
        clearest = alike[first, second].topk(min(MATCHES, len(first))).indices
        seen = angles(there[second[clearest]] / (0.5 / np.tan(np.radians(FIELD_OF_VIEW / 2))))
        best = 0.0, 0.0
        for focal in FOCAL:
            turned = seen - angles(self.places[first[clearest]] / focal)
            together = torch.cdist(turned, turned, p=torch.inf) < TOLERANCE
            count, middle = together.sum(1).max(0)
            if count > best[0]:
                best = float(count), float(torch.rad2deg(turned[together[middle], 0].mean()))
        return best


def _points(picture: NDArray[np.uint8], unit: float) -> tuple[Tensor, Tensor]:
    """Return where points are, to the right of and above the middle, in ``unit`` pixels, and their vectors."""
    positions, vectors = xfeat()(picture)
    height, width = picture.shape[:2]
    aside = torch.from_numpy(positions - np.array([width, height], np.float32) / 2) / unit
    return aside * torch.tensor([1.0, -1.0]), torch.from_numpy(vectors)


def _resized(picture: NDArray[np.uint8], factor: float) -> NDArray[np.uint8]:
    height, width = (max(1, round(side * factor)) for side in picture.shape[:2])
    return np.asarray(Image.fromarray(picture).resize((width, height), Image.Resampling.BICUBIC))
