"""Patches of virtual views, behind those of each view."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dirl.perception.backbones.encoder import ViewEncoder
from dirl.perception.backbones.registry import Encoded, encode_all
from dirl.perception.virtual import VirtualCameras


def with_virtual(encoder: ViewEncoder, cameras: VirtualCameras | None) -> ViewEncoder:
    """The encoder with virtual cameras, if there are any, in the description of its patches."""
    if cameras is None:
        return encoder
    own = encoder.patch_attributes["extractor"]
    return replace(encoder, patch_attributes={**encoder.patch_attributes, "extractor": f"{own}; {cameras}"})


def encode_with_virtual(
    encoder: ViewEncoder,
    view: Callable[[int], NDArray[np.uint8]],
    surrounding: NDArray[np.int64],
    cameras: VirtualCameras | None,
    origin: str,
    *,
    progress: bool = True,
) -> Encoded:
    """Features and patches of N views, and behind the patches of each view those of its virtual views, if any.

    Args:
        encoder: with fine patches, if there are cameras.
        view: that of a state, RGB, uint8 ``[H, W, 3]``; asked for when it is encoded.
        surrounding: of each state the views ahead, right, back and left, int64 ``[N, 4]``.
        cameras: whose views are encoded too.
        origin: named in errors.
        progress: show a progress bar.
    """
    count = len(surrounding)
    found = encode_all(encoder, map(view, range(count)), count, origin, progress=progress)
    if cameras is None:
        return found
    virtual = (seen for four in surrounding for seen in cameras.see(np.stack([view(state) for state in four])))
    further = encode_all(encoder, virtual, count * len(cameras.yaws), origin, progress=progress)
    assert found.patches is not None
    assert further.patches is not None
    cells = further.patches.reshape(count, -1, further.patches.shape[-1])
    return Encoded(found.features, np.concatenate([found.patches, cells], 1))
