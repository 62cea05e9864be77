"""Recognition by whitened features and a bag of whitened patches."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dirl.backbones.principal import principal_components

COMPONENTS = 64
"""Of the pooled features, and of a patch, at most."""


class Patches(nn.Module):
    """Compares views by whitened pooled features and by a bag of whitened patches.

    The features of one building are alike in most directions, because its walls and furniture are everywhere. Whitening
    by the statistics of views, best those of the place itself, weighs what tells its views apart. In the bag each patch
    of one view looks for its most similar patch in the other, wherever it is. The mean of these maxima, taken both
    ways, bears a turn by some degrees, which moves everything in the picture.

    Args:
        share: of the bag in the score of two views; the rest is the cosine of the whitened pooled features.
    """

    reads_patches = True

    def __init__(self, share: float = 0.5) -> None:
        super().__init__()
        self.share = share
        for name in ("mean", "axes", "patch_mean", "patch_axes"):
            self.register_buffer(name, None)

    mean: Tensor
    axes: Tensor
    patch_mean: Tensor
    patch_axes: Tensor

    def fit(self, features: Tensor, patches: Tensor) -> "Patches":
        """Take the statistics of views.

        Args:
            features: pooled ones of N views, float ``[N, D]``.
            patches: float ``[N, cells, channels]``.
        """
        cells = patches.flatten(0, 1).float()
        self.mean, self.axes, _ = principal_components(features.float(), COMPONENTS)
        self.patch_mean, self.patch_axes, _ = principal_components(cells, COMPONENTS)
        return self

    def describe(self, features: Tensor, patches: Tensor | None = None) -> Tensor:
        """Whitened features and patches, each of length one, behind each other; see `Recogniser.describe`."""
        assert patches is not None
        pooled = F.normalize((features.float() - self.mean) @ self.axes, dim=-1)
        bag = F.normalize((patches.float() - self.patch_mean) @ self.patch_axes, dim=-1)
        return torch.cat([pooled, bag.flatten(-2)], -1)

    def scores(self, seen: Tensor, references: Tensor) -> Tensor:
        """The mean over views, in [-1, 1]; see `Recogniser.scores`."""
        total: Tensor | float = 0.0
        for a, b in zip(seen.unbind(-2), references.unbind(-2), strict=True):
            total = total + self._of_views(a, b)
        return torch.as_tensor(total) / seen.shape[-2]

    def _of_views(self, seen: Tensor, references: Tensor) -> Tensor:
        """Of single views, ``[..., A, F]`` and ``[..., B, F]`` to ``[..., A, B]``."""
        pooled, width = self.axes.shape[1], self.patch_axes.shape[1]
        whole = seen[..., :pooled] @ references[..., :pooled].transpose(-1, -2)
        bags = [part[..., pooled:].unflatten(-1, (-1, width)) for part in (seen, references)]
        cosines = torch.einsum("...acw,...bdw->...abcd", *bags)
        bag = (cosines.amax(-1).mean(-1) + cosines.amax(-2).mean(-1)) / 2
        return self.share * bag + (1 - self.share) * whole
