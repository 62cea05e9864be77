"""Recognition by whitened features and a bag of whitened patches."""

import copy
from pathlib import Path
from typing import Annotated, Literal, Self

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dirl.config.bounds import Bounds
from dirl.perception.backbones.patches import coarse
from dirl.perception.backbones.principal import principal_components
from dirl.perception.recognition.recogniser import Thresholds

COMPONENTS = 64
"""Of the pooled features, and of a patch, at most."""

STATISTICS = Path(__file__).parent / "data" / "statistics.pt"
"""Those of training rooms, for features of the included ResNet-50 at 96x128 pixels."""


class Patches(nn.Module):
    """Compares views by whitened pooled features and by a bag of whitened patches.

    The features of one building are alike in most directions, because its walls and furniture are everywhere. Whitening
    by the statistics of views weighs what tells its views apart. In the bag each patch of one view looks for its most
    similar patch in the other, wherever it is. The mean of these maxima, taken both ways, bears a turn by some degrees,
    which moves everything in the picture.

    Args:
        statistics: ``rooms``, those of training rooms, which serve in an unseen place; or ``place``, those
            of the place itself, from a map or a scene.
        share: of the bag in the score of two views; the rest is the cosine of the whitened pooled features.
        views: above this score four views are the goal's; see `Thresholds`.
        photo: above this score one view is the goal's.
        memory: above this score two visits are of the same place and heading.
    """

    reads_patches = True
    calibrated = False

    def __init__(
        self,
        statistics: Literal["rooms", "place"] = "rooms",
        share: Annotated[float, Bounds(0, 1)] = 0.5,
        views: Annotated[float, Bounds(-1, 1)] = 0.72,
        photo: Annotated[float, Bounds(-1, 1)] = 0.75,
        memory: Annotated[float, Bounds(-1, 1)] = 0.7,
    ) -> None:
        super().__init__()
        self.statistics, self.share = statistics, share
        self.thresholds = Thresholds(views, photo, memory)
        stored = torch.load(STATISTICS, weights_only=True) if statistics == "rooms" else {}
        for name in ("mean", "axes", "patch_mean", "patch_axes"):
            self.register_buffer(name, stored[name].float() if name in stored else torch.empty(0))

    mean: Tensor
    axes: Tensor
    patch_mean: Tensor
    patch_axes: Tensor

    def fit(self, features: Tensor, patches: Tensor | None = None) -> Self:
        """The recogniser of a place, by whose own statistics it whitens if it is made so; see `Recogniser.fit`."""
        if self.statistics == "rooms":
            return self
        if patches is None:
            raise ValueError("recogniser=patches compares patches, and these views have none; encode them with patches")
        return copy.deepcopy(self).measure(features, patches)

    def measure(self, features: Tensor, patches: Tensor) -> Self:
        """Take the statistics of N views: pooled features, float ``[N, D]``, and patches, ``[N, cells, channels]``."""
        self.mean, axes = principal_components(features.float(), COMPONENTS)
        self.patch_mean, patch_axes = principal_components(coarse(patches).flatten(0, 1).float(), COMPONENTS)
        self.axes, self.patch_axes = (F.pad(found, (0, COMPONENTS - found.shape[1])) for found in (axes, patch_axes))
        return self

    def describe(self, features: Tensor, patches: Tensor | None = None) -> Tensor:
        """Whitened features and patches, each of length one, behind each other; see `Recogniser.describe`."""
        if not len(self.mean):
            raise ValueError("recogniser=patches with statistics=place knows no place yet; use statistics=rooms")
        if patches is None or features.shape[-1] != len(self.mean):
            raise ValueError(
                f"recogniser=patches compares patches and {len(self.mean)} features a view; these views have "
                f"{'no patches' if patches is None else features.shape[-1]}: encode them with encoder=resnet50_small"
            )
        pooled = F.normalize((features.float() - self.mean) @ self.axes, dim=-1)
        bag = F.normalize((coarse(patches).float() - self.patch_mean) @ self.patch_axes, dim=-1)
        return torch.cat([pooled, bag.flatten(-2)], -1)

    def scores(self, seen: Tensor, references: Tensor) -> Tensor:
        """The mean over views, in [-1, 1]; see `Recogniser.scores`."""
        views = references.shape[-2]
        pairs = zip(seen.unbind(-2)[:views], references.unbind(-2), strict=True)
        return torch.stack([self._of_views(*pair) for pair in pairs]).mean(0)

    def _of_views(self, seen: Tensor, references: Tensor) -> Tensor:
        """Of single views, ``[..., A, F]`` and ``[..., B, F]`` to ``[..., A, B]``."""
        whole = seen[..., :COMPONENTS] @ references[..., :COMPONENTS].transpose(-1, -2)
        bags = [part[..., COMPONENTS:].unflatten(-1, (-1, COMPONENTS)) for part in (seen, references)]
        cosines = torch.einsum("...acw,...bdw->...abcd", *bags)
        bag = (cosines.amax(-1).mean(-1) + cosines.amax(-2).mean(-1)) / 2
        return self.share * bag + (1 - self.share) * whole
