"""The ResNet-50 that comes with the package: product-quantised weights, decoded to a state_dict.

From "And the Bit Goes Down: Revisiting the Quantization of Neural Networks" (Stock et al., ICLR 2020), under
CC BY-NC 4.0; see ``data/NOTICE.md``. The features of the built-in rooms were computed with these weights.
"""

from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from dirl.backbones.resnet import ResNet50, backbone_of

DATA = Path(__file__).parent / "data"

WEIGHTS = DATA / "resnet50_kill_the_bits.pth"

BATCH_NORM_EPS = 1e-5
"""What batch norms add to the variance, torch's default."""

PROVENANCE = (
    "ResNet-50 of facebookresearch/kill-the-bits at 9ea70f1 (product-quantised, large blocks, decoded), CC BY-NC 4.0"
)
"""Stored with the features; the built-in rooms bear the same words."""


def shipped_backbone() -> ResNet50:
    """The backbone with the shipped weights, float32."""
    layers: dict[str, dict[str, Any]] = torch.load(WEIGHTS, map_location="cpu", weights_only=True)
    state: dict[str, Tensor] = {}
    for name, layer in layers.items():
        if name.startswith("fc"):  # the classifier, which features do not need
            continue
        if "assignments" in layer:
            state[f"{name}.weight"] = decode_convolution(
                layer["centroids"], layer["assignments"], layer["n_blocks"], layer["k"]
            )
            continue
        state |= {f"{name}.{key}": value.float() for key, value in layer.items()}
        if "bias" in layer:  # a batch norm; its statistics are folded into weight and bias: mean 0, variance + eps 1
            state[f"{name}.running_mean"] = torch.zeros_like(state[f"{name}.bias"])
            state[f"{name}.running_var"] = torch.ones_like(state[f"{name}.bias"]) - BATCH_NORM_EPS
    return backbone_of(state, str(WEIGHTS))


def decode_convolution(centroids: Tensor, assignments: Tensor, n_blocks: int, k: int) -> Tensor:
    """The weight of a product-quantised convolution, float32 ``[out, in, k, k]``.

    Args:
        centroids: the codebook: blocks of b weights of one output channel, ``[entries, b]``.
        assignments: the entry of each block, integers ``[n_blocks * out]``; the blocks of all channels at one place
            follow each other.
        n_blocks: blocks of an output channel, ``in * k * k / b``.
        k: height and width of the kernel.
    """
    blocks = centroids.float()[assignments.long()].reshape(n_blocks, -1, centroids.shape[1])
    return blocks.transpose(0, 1).reshape(blocks.shape[1], -1, k, k)
