"""The frozen backbone: ResNet-50 with torchvision's parameter names, from camera views to features.

The weights that come with the package, which made the features of the built-in rooms, are product-quantised: "And the
Bit Goes Down: Revisiting the Quantization of Neural Networks" (Stock et al., ICLR 2020), CC BY-NC 4.0; see
``data/NOTICE.md``.
"""

import copy
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from dirl.perception.backbones.encoder import resized
from dirl.scenes.io.files import read_weights

SIZE = (224, 224)
"""Height and width, in pixels, that views are resized to unless a caller says otherwise."""
MEAN, STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""Mean and deviation of ImageNet's red, green and blue, on a scale from 0 to 1."""

DATA = Path(__file__).parent / "data"

WEIGHTS = DATA / "resnet50_kill_the_bits.pth"

BATCH_NORM_EPS = 1e-5
"""What batch norms add to the variance, torch's default."""

PROVENANCE = (
    "ResNet-50 of facebookresearch/kill-the-bits at 9ea70f1 (product-quantised, large blocks, decoded), CC BY-NC 4.0"
)
"""Stored with the features; the built-in rooms bear the same words."""


class Bottleneck(nn.Module):
    """Three convolutions around a shortcut; the 3x3 one carries the stride (v1.5)."""

    def __init__(self, inputs: int, width: int, stride: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, width, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        self.conv2 = nn.Conv2d(width, width, 3, stride, padding=1, bias=False)
        self.bn2 = nn.BatchNorm2d(width)
        self.conv3 = nn.Conv2d(width, 4 * width, 1, bias=False)
        self.bn3 = nn.BatchNorm2d(4 * width)
        self.downsample = nn.Sequential()
        if inputs != 4 * width:  # the first block of a layer, which alone changes the shape
            self.downsample = nn.Sequential(
                nn.Conv2d(inputs, 4 * width, 1, stride, bias=False), nn.BatchNorm2d(4 * width)
            )

    def forward(self, x: Tensor) -> Tensor:
        """Transform maps ``[B, inputs, H, W]`` to ``[B, 4 width, H / stride, W / stride]``."""
        y = F.relu(self.bn1(self.conv1(x)))
        y = F.relu(self.bn2(self.conv2(y)))
        return F.relu(self.bn3(self.conv3(y)) + self.downsample(x))


def _layer(inputs: int, width: int, blocks: int, stride: int) -> nn.Sequential:
    rest = [Bottleneck(4 * width, width, 1) for _ in range(blocks - 1)]
    return nn.Sequential(Bottleneck(inputs, width, stride), *rest)


class ResNet50(nn.Module):
    """ResNet-50 without its classifier, frozen: no parameter has a gradient, and the batch statistics do not change.

    The names in its state_dict are torchvision's, but for ``fc``. The initial weights are random; see `load_backbone`.
    """

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, 64, 7, 2, padding=3, bias=False)
        self.bn1 = nn.BatchNorm2d(64)
        self.layer1 = _layer(64, 64, blocks=3, stride=1)
        self.layer2 = _layer(256, 128, blocks=4, stride=2)
        self.layer3 = _layer(512, 256, blocks=6, stride=2)
        self.layer4 = _layer(1024, 512, blocks=3, stride=2)
        self.requires_grad_(False).eval()

    def train(self, mode: bool = True) -> Self:
        """Stay in evaluation mode, also when a network that holds the backbone is trained."""
        return super().train(False)

    def forward(self, images: Tensor) -> Tensor:
        """Return the global average pool, ``[B, 2048]``, of normalised images (see `preprocess`), ``[B, 3, H, W]``."""
        return self.pool(self.third_stage(images))

    def third_stage(self, images: Tensor) -> Tensor:
        """Return the third stage's map, ``[B, 1024, H / 16, W / 16]``, of normalised images, ``[B, 3, H, W]``."""
        x = F.relu(self.bn1(self.conv1(images)))
        x = F.max_pool2d(x, 3, 2, padding=1)
        return self.layer3(self.layer2(self.layer1(x)))

    def pool(self, third_stage: Tensor) -> Tensor:
        """Return features, ``[B, 2048]``, of the third stage's map."""
        return self.layer4(third_stage).mean((2, 3))


def preprocess(views: Tensor, size: tuple[int, int] = SIZE) -> Tensor:
    """Return the backbone's input: views `resized`, scaled to [0, 1], and normalised as on ImageNet.

    Args:
        views: RGB, uint8 ``[B, H, W, 3]``.
        size: height and width to resize to, pixels.

    Returns:
        float32 ``[B, 3, *size]``, on the device of the views.

    Raises:
        ValueError: the views have another shape or type.
    """
    normalised = (resized(views, size) / 255 - torch.tensor(MEAN)) / torch.tensor(STD)
    return normalised.permute(0, 3, 1, 2).contiguous().to(views.device)


def fused(backbone: ResNet50) -> ResNet50:
    """Return a copy with every batch norm folded into its convolution: the same features up to float32 rounding."""
    backbone = copy.deepcopy(backbone)
    for module in list(backbone.modules()):
        for k in [name.removeprefix("conv") for name, _ in module.named_children() if name.startswith("conv")]:
            setattr(module, f"conv{k}", fuse_conv_bn_eval(getattr(module, f"conv{k}"), getattr(module, f"bn{k}")))
            setattr(module, f"bn{k}", nn.Identity())
        if isinstance(module, Bottleneck) and len(module.downsample):
            module.downsample = nn.Sequential(fuse_conv_bn_eval(*module.downsample))
    return backbone


def load_backbone(path: str | Path) -> ResNet50:
    """Load the backbone with the weights in a file.

    Args:
        path: a state_dict with torchvision's names for ResNet-50, saved by ``torch.save``, of any floating-point type.
            The classifier, ``fc``, and the counters ``num_batches_tracked`` may be missing and are ignored.

    Raises:
        ValueError: there is no such file, or it does not hold the parameters of a ResNet-50.
    """
    return backbone_of(read_weights(Path(path)), str(path))


def backbone_of(stored: Mapping[str, Tensor], origin: str) -> ResNet50:
    """Return the backbone with the weights of a state_dict, see `load_backbone`; errors name ``origin``."""
    with torch.device("meta"):  # random weights would take most of the time
        backbone = ResNet50()
    counters = {name: torch.tensor(0) for name in backbone.state_dict() if name.endswith(".num_batches_tracked")}
    given = {name: value for name, value in stored.items() if not is_ignored(name)}
    try:
        backbone.load_state_dict(given | counters, assign=True)
    except RuntimeError as error:  # torch names every parameter
        raise ValueError(f"{origin}: are no weights of a ResNet-50 ({' '.join(str(error).split())[:200]})") from None
    return backbone


def is_ignored(name: str) -> bool:
    """Return True for parameters of no use: the classifier, and counters of the training, which some files lack."""
    return name.startswith("fc.") or name.endswith(".num_batches_tracked")


def shipped_backbone() -> ResNet50:
    """Load the backbone with the shipped weights, float32."""
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
    """Return the weight of a product-quantised convolution, float32 ``[out, in, k, k]``.

    Args:
        centroids: the codebook: blocks of b weights of one output channel, ``[entries, b]``.
        assignments: the entry of each block, integers ``[n_blocks * out]``; the blocks of all channels at one place
            follow each other.
        n_blocks: blocks of an output channel, ``in * k * k / b``.
        k: height and width of the kernel.
    """
    blocks = centroids.float()[assignments.long()].reshape(n_blocks, -1, centroids.shape[1])
    return blocks.transpose(0, 1).reshape(blocks.shape[1], -1, k, k)
