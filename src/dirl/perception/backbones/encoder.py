"""The interface of an encoder: a frozen backbone with its preprocessing, and its exact description."""

import hashlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from dirl.scenes.io.hdf5 import EXTRACTOR_ATTRIBUTES


class EncoderError(ValueError):
    """An encoder that is not available, or cannot encode these views."""


@dataclass(frozen=True)
class ViewEncoder:
    """A frozen backbone with its preprocessing, made by `load_encoder`; `dirl.Navigator` takes it too.

    Args:
        forward: RGB views, uint8 ``[B, H, W, 3]``, to features, float32 ``[B, D]``.
        attributes: its description, as dumps store it: ``extractor``, ``preprocessing``, ``weights`` (a SHA-256 over
            the parameters that are used, whatever file they came in), ``provenance``.
        forward_patches: RGB views to features and patches (see `dirl.perception.backbones.patches`), float32 ``[B, D]``
            and ``[B, cells, channels]``; None where no patches were asked for.
        patch_attributes: how the patches are made, as dumps store it: ``extractor``, ``projection``.
        fine: whether the patches are fine ones.
    """

    forward: Callable[[Tensor], Tensor]
    attributes: Mapping[str, str]
    forward_patches: Callable[[Tensor], tuple[Tensor, Tensor]] | None = None
    patch_attributes: Mapping[str, str] = field(default_factory=dict)
    fine: bool = False

    @property
    def extractor(self) -> str:
        """The attributes as one text; scenes can share a world only if theirs are equal (``Scene.extractor``)."""
        return "; ".join(self.attributes[key] for key in EXTRACTOR_ATTRIBUTES if self.attributes.get(key))

    def __call__(self, views: Tensor) -> Tensor:
        """Return features, float32 ``[B, D]``, of RGB views, uint8 ``[B, H, W, 3]``."""
        return self.forward(views)


def staged_encoder(
    inner: Callable[[Tensor], Tensor],
    pool: Callable[[Tensor], Tensor],
    attributes: Mapping[str, str],
    projection: Callable[[Tensor], Tensor] | None = None,
    patch_attributes: Mapping[str, str] | None = None,
    *,
    few: int | None = None,
    fine: bool = False,
) -> ViewEncoder:
    """Make an encoder: ``inner`` gives a map, ``pool`` its features and ``projection`` its patches, maybe fine ones.

    At most ``few`` views go through the network at a time; without a projection there are no patches. It can be
    pickled if all of these can.
    """
    staged = _Staged(inner, pool, projection, few)
    if projection is None:
        return ViewEncoder(staged.features, attributes)
    return ViewEncoder(staged.features, attributes, staged.features_and_patches, patch_attributes or {}, fine)


@dataclass(frozen=True)
class _Staged:
    """The parts of `staged_encoder`."""

    inner: Callable[[Tensor], Tensor]
    pool: Callable[[Tensor], Tensor]
    projection: Callable[[Tensor], Tensor] | None
    few: int | None

    def stages(self, views: Tensor) -> Iterator[Tensor]:
        return map(self.inner, views.split(self.few or len(views) or 1))

    @torch.inference_mode()
    def features(self, views: Tensor) -> Tensor:
        return torch.cat([self.pool(stage).float() for stage in self.stages(views)])

    @torch.inference_mode()
    def features_and_patches(self, views: Tensor) -> tuple[Tensor, Tensor]:
        assert self.projection is not None
        both = ((self.pool(stage).float(), self.projection(stage)) for stage in self.stages(views))
        pooled, parts = zip(*both, strict=True)
        return torch.cat(pooled), torch.cat(parts)


def resized(views: Tensor, size: tuple[int, int]) -> Tensor:
    """Resize views by Pillow, to float32 ``[B, *size, 3]`` in [0, 255], on the CPU.

    Pillow resizes one view at a time, because that is how the features of the built-in rooms were made. torch's
    own antialiasing rounds differently and changes features by 0.2 %; without antialiasing they change by 15 %.

    Raises:
        ValueError: the views are not uint8 ``[B, H, W, 3]``.
    """
    if views.dtype != torch.uint8 or views.ndim != 4 or views.shape[-1] != 3:
        raise ValueError(f"views are uint8 [B, H, W, 3], not {views.dtype} {list(views.shape)}")
    images = torch.empty(len(views), *size, 3)
    for image, view in zip(images, views.cpu().numpy(), strict=True):
        image[:] = torch.from_numpy(np.array(Image.fromarray(view).resize(size[::-1], Image.Resampling.BILINEAR)))
    return images


def reduced(views: Tensor, pixels: int | None) -> Tensor:
    """Return views, uint8 ``[B, H, W, 3]``, at most so many pixels wide: wider ones are reduced; None = as they are.

    A network that learned from coarse views is too sure of what it tells by the details of sharp ones.
    """
    height, width = views.shape[1:3]
    if pixels is None or width <= pixels:
        return views
    return resized(views, (max(1, round(height * pixels / width)), pixels)).to(torch.uint8).to(views.device)


def weights_hash(parameters: Mapping[str, Tensor]) -> str:
    """Return ``sha256:`` and 64 digits over a state_dict's names, shapes and values (as float32), in order of names."""
    digest = hashlib.sha256()
    for name in sorted(parameters):
        values = parameters[name].detach().cpu()
        values = values.float() if values.is_floating_point() else values
        digest.update(f"{name} {list(values.shape)}\n".encode())
        digest.update(values.contiguous().numpy().tobytes())
    return f"sha256:{digest.hexdigest()}"
