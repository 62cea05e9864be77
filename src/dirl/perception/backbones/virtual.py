"""Patches of virtual views, behind those of each view."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dirl.perception.backbones.encoder import ViewEncoder
from dirl.perception.backbones.registry import Encoded, encode_all
from dirl.perception.virtual import VirtualCameras


def with_virtual(encoder: ViewEncoder, cameras: VirtualCameras) -> ViewEncoder:
    """The encoder with virtual cameras, if there are any, in the description of its patches."""
    if not cameras.fov:
        return encoder
    own = encoder.patch_attributes["extractor"]
    return replace(encoder, patch_attributes={**encoder.patch_attributes, "extractor": f"{own}; {cameras}"})


def encode_with_virtual(
    encoder: ViewEncoder,
    views: Sequence[NDArray[np.uint8]],
    surrounding: NDArray[np.int64],
    cameras: VirtualCameras,
    origin: str,
    *,
    progress: bool = True,
) -> Encoded:
    """Features and patches of views, and behind the patches of each view those of its virtual views.

    Args:
        encoder: with fine patches.
        views: RGB, uint8 ``[H, W, 3]`` each, N.
        surrounding: of each state the views ahead, right, back and left, int64 ``[N, 4]``.
        cameras: without a field of view there are no virtual views.
        origin: named in errors.
        progress: show a progress bar.
    """
    found = encode_all(encoder, iter(views), len(views), origin, progress=progress)
    if not cameras.fov or found.patches is None:
        return found
    virtual = (seen for four in surrounding for seen in cameras.see(np.stack([views[view] for view in four])))
    further = encode_all(encoder, virtual, len(views) * len(cameras.yaws), origin, progress=progress).patches
    assert further is not None
    cells = further.reshape(len(views), -1, further.shape[-1])
    return Encoded(found.features, np.concatenate([found.patches, cells], 1))
