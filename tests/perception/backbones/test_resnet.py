import re

import numpy as np
import pytest
import torch
from torch import nn

from dirl.perception.backbones.resnet import ResNet50, fused, load_backbone, preprocess

COUNTER = "num_batches_tracked"
MEAN, STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # of ImageNet, as everybody writes them


@pytest.fixture(scope="module")
def backbone():
    with torch.random.fork_rng():
        torch.manual_seed(0)
        return ResNet50()


@pytest.fixture
def views():
    return torch.from_numpy(np.random.default_rng(0).integers(0, 256, (3, 30, 40, 3), np.uint8))


@pytest.fixture
def weights(backbone):
    """What a file may hold. Each array is one number repeated, so that the file is small."""
    return {name: torch.full((), 0.01).expand(value.shape) for name, value in backbone.state_dict().items()}


def save(weights, folder):
    torch.save(weights, folder / "weights.pth")
    return folder / "weights.pth"


def test_parameters_are_as_many_as_torchvisions_without_fc(backbone):
    parameters = sum(parameter.numel() for parameter in backbone.parameters())
    assert parameters == 23_508_032
    assert parameters + 2048 * 1000 + 1000 == 25_557_032
    assert len(backbone.state_dict()) == 318


def test_backbone_stays_frozen_inside_a_network_that_is_trained(backbone, views):
    network = nn.Sequential(backbone, nn.BatchNorm1d(2048)).train()
    before = {name: value.clone() for name, value in backbone.state_dict().items()}
    network(preprocess(views))
    assert all(torch.equal(value, before[name]) for name, value in backbone.state_dict().items())
    assert not any(module.training for module in backbone.modules())
    assert not any(parameter.requires_grad for parameter in backbone.parameters())
    assert network[1].training


def test_fusing_batch_norms_changes_nothing_but_rounding():
    backbone = ResNet50()
    for module in backbone.modules():  # statistics that matter
        if isinstance(module, nn.BatchNorm2d):
            module.running_mean.normal_(std=0.1)
            module.running_var.uniform_(0.5, 2)
    images = torch.randn(2, 3, 64, 96)
    torch.testing.assert_close(fused(backbone)(images), backbone(images), rtol=1e-3, atol=1e-4)
    assert not any(isinstance(module, nn.BatchNorm2d) for module in fused(backbone).modules())
    assert isinstance(backbone.bn1, nn.BatchNorm2d)


def test_images_are_normalised_by_channel():
    colour = torch.tensor([10, 100, 200], dtype=torch.uint8)
    images = preprocess(colour.expand(2, 300, 400, 3))
    assert images.shape == (2, 3, 224, 224)
    assert images.dtype == torch.float32
    expected = (colour / 255 - torch.tensor(MEAN)) / torch.tensor(STD)
    torch.testing.assert_close(images, expected[:, None, None].expand(2, 3, 224, 224))


def test_resizing_is_antialiased():
    # One pixel in three is lit, each at the centre of a pixel of the small image: picking would light them all.
    view = torch.zeros(1, 672, 672, 3, dtype=torch.uint8)
    view[:, 1::3, 1::3] = 255
    grey = preprocess(view) * torch.tensor(STD)[:, None, None] + torch.tensor(MEAN)[:, None, None]
    assert 0.1 < grey.mean() < 0.13  # 1 / 9 of the light


def test_classifier_and_counters_are_optional(tmp_path, weights):
    bare = {name: value for name, value in weights.items() if COUNTER not in name}
    load_backbone(save(bare | {"fc.weight": torch.zeros(7, 2048), "fc.bias": torch.zeros(7)}, tmp_path))


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (None, "there is no such file"),
        (b"PK\x03\x04 cut short", "not a file of weights that torch can load"),
        ({"epoch": 3}, "not a state_dict"),
    ],
)
def test_a_file_without_weights_is_named(tmp_path, content, problem):
    path = tmp_path / "weights.pth"
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content is not None:
        save(content, tmp_path)
    with pytest.raises(ValueError, match=re.escape(f"{path}: {problem}")):
        load_backbone(path)


FIRST, EXPECTED = "layer1.0.conv1.weight", "expected floats [64, 64, 1, 1], found torch"


@pytest.mark.parametrize(
    ("left_out", "other", "problem"),
    [
        ("layer2.1", {}, "'layer2.1.conv1.weight' is missing"),
        (
            "",
            {"module.conv1.weight": torch.zeros(1)},
            "'conv1.weight' is missing; the file's names begin with ['module.",
        ),
        ("none", {FIRST: torch.zeros(128, 64, 1, 1)}, f"'{FIRST}': {EXPECTED}.float32 [128, 64, 1, 1]"),
        ("none", {FIRST: torch.zeros(64, 64, 1, 1).long()}, f"'{FIRST}': {EXPECTED}.int64 [64, 64, 1, 1]"),
        ("none", {"layer3.6.conv1.weight": torch.zeros(1)}, "'layer3.6.conv1.weight' is no parameter of a ResNet-50"),
    ],
    ids=["missing", "of other names", "misshaped", "of integers", "of a deeper network"],
)
def test_first_wrong_parameter_is_named(tmp_path, weights, left_out, other, problem):
    path = save({name: value for name, value in weights.items() if not name.startswith(left_out)} | other, tmp_path)
    with pytest.raises(ValueError, match=re.escape(f"{path}: {problem}")):
        load_backbone(path)
