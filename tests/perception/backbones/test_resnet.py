import re

import numpy as np
import pytest
import torch
from torch import nn

from dirl.perception.backbones.resnet import ResNet50, encode, fused, load_backbone, preprocess

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


# What torchvision.models.resnet50() has, as far as it fits here.
@pytest.mark.parametrize(
    ("name", "shape"),
    [
        ("conv1.weight", (64, 3, 7, 7)),
        ("bn1.running_var", (64,)),
        ("layer1.0.conv1.weight", (64, 64, 1, 1)),
        ("layer1.0.downsample.0.weight", (256, 64, 1, 1)),
        ("layer1.0.downsample.1.running_mean", (256,)),
        ("layer1.2.conv3.weight", (256, 64, 1, 1)),
        ("layer2.0.conv1.weight", (128, 256, 1, 1)),
        ("layer2.3.conv2.weight", (128, 128, 3, 3)),
        ("layer3.0.downsample.0.weight", (1024, 512, 1, 1)),
        ("layer3.5.bn2.bias", (256,)),
        ("layer4.0.conv2.weight", (512, 512, 3, 3)),
        ("layer4.2.bn3.weight", (2048,)),
        ("layer4.2.bn3.num_batches_tracked", ()),
    ],
)
def test_parameter_is_torchvisions(backbone, name, shape):
    assert backbone.state_dict()[name].shape == shape


def test_parameters_are_as_many_as_torchvisions_without_fc(backbone):
    parameters = sum(parameter.numel() for parameter in backbone.parameters())
    assert parameters == 23_508_032
    assert parameters + 2048 * 1000 + 1000 == 25_557_032
    assert len(backbone.state_dict()) == 318


def test_layers_halve_the_image_in_the_3x3_convolution(backbone):
    first = [layer[0] for layer in (backbone.layer1, backbone.layer2, backbone.layer3, backbone.layer4)]
    assert [block.conv1.stride[0] for block in first] == [1, 1, 1, 1]
    assert [block.conv2.stride[0] for block in first] == [1, 2, 2, 2]
    assert [block.downsample[0].stride[0] for block in first] == [1, 2, 2, 2]


def test_features_are_2048_for_an_image(backbone):
    features = backbone(torch.randn(2, 3, 224, 224, generator=torch.Generator().manual_seed(0)))
    assert features.shape == (2, 2048)
    assert features.dtype == torch.float32
    assert features.isfinite().all()
    assert (features >= 0).all()
    assert not features.requires_grad


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


def test_the_third_stage_is_a_sixteenth_of_the_image(backbone):
    images = torch.randn(1, 3, 96, 128)
    stage = backbone.third_stage(images)
    assert stage.shape == (1, 1024, 6, 8)
    torch.testing.assert_close(backbone.pool(stage), backbone(images))


@pytest.mark.parametrize("size", [(224, 224), (300, 400), (50, 30)])
def test_images_are_normalised_by_channel(size):
    colour = torch.tensor([10, 100, 200], dtype=torch.uint8)
    images = preprocess(colour.expand(2, *size, 3))
    assert images.shape == (2, 3, 224, 224)
    assert images.dtype == torch.float32
    expected = (colour / 255 - torch.tensor(MEAN)) / torch.tensor(STD)
    torch.testing.assert_close(images, expected[:, None, None].expand(2, 3, 224, 224))


def test_image_of_the_right_size_keeps_its_pixels():
    view = np.random.default_rng(0).integers(0, 256, (1, 224, 224, 3), np.uint8)
    pixels = preprocess(torch.from_numpy(view)).permute(0, 2, 3, 1) * torch.tensor(STD) + torch.tensor(MEAN)
    np.testing.assert_allclose(pixels.numpy() * 255, view, atol=1e-3)


def test_resizing_is_antialiased():
    # One pixel in three is lit, each at the centre of a pixel of the small image: picking would light them all.
    view = torch.zeros(1, 672, 672, 3, dtype=torch.uint8)
    view[:, 1::3, 1::3] = 255
    grey = preprocess(view) * torch.tensor(STD)[:, None, None] + torch.tensor(MEAN)[:, None, None]
    assert 0.1 < grey.mean() < 0.13  # 1 / 9 of the light


@pytest.mark.parametrize(
    "views", [torch.zeros(1, 8, 8, 3), torch.zeros(8, 8, 3).byte(), torch.zeros(1, 3, 8, 8).byte()]
)
def test_what_are_no_views_is_refused(views):
    with pytest.raises(ValueError, match="views are uint8"):
        preprocess(views)


def test_encoding_in_batches_keeps_the_order(backbone, views):
    features = encode(backbone, views, batch=2)
    assert not features.requires_grad
    alone = torch.cat([backbone(preprocess(view[None])) for view in views])
    assert (alone[0] - alone[2]).norm() > 1e-3 * alone[0].norm()  # else the order would not show
    torch.testing.assert_close(features, alone, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("dtype", [torch.float16, torch.float32, torch.float64])
def test_weights_of_any_precision_become_float32(tmp_path, weights, dtype):
    loaded = load_backbone(save({name: value.to(dtype) for name, value in weights.items()}, tmp_path))
    torch.testing.assert_close(loaded.conv1.weight, torch.full((64, 3, 7, 7), 0.01), rtol=1e-3, atol=0)
    torch.testing.assert_close(loaded.bn1.running_var, torch.full((64,), 0.01), rtol=1e-3, atol=0)
    assert {value.dtype for name, value in loaded.state_dict().items() if COUNTER not in name} == {torch.float32}
    assert not any(parameter.requires_grad for parameter in loaded.parameters())
    assert not loaded.training


def test_classifier_and_counters_are_optional(tmp_path, weights):
    bare = {name: value for name, value in weights.items() if COUNTER not in name}
    load_backbone(save(bare, tmp_path))
    load_backbone(save(bare | {"fc.weight": torch.zeros(7, 2048), "fc.bias": torch.zeros(7)}, tmp_path))


@pytest.mark.parametrize("content", [None, b"", b"not weights", b"PK\x03\x04 cut short", b"\x80\x02}q\x00."])
def test_missing_or_broken_file_is_named(tmp_path, content):
    path, problem = tmp_path / "weights.pth", "there is no such file"
    if content is not None:
        path.write_bytes(content)
        problem = "not a file of weights that torch can load"
    with pytest.raises(ValueError, match=re.escape(f"{path}: {problem}")):
        load_backbone(path)


def test_file_that_holds_code_is_refused(tmp_path):
    with pytest.raises(ValueError, match="not a file of weights that torch can load safely"):
        load_backbone(save(nn.Linear(1, 1), tmp_path))


@pytest.mark.parametrize("content", [torch.zeros(3), {}, {"epoch": 3}, {"state_dict": {}}, {0: torch.zeros(3)}])
def test_what_is_no_state_dict_is_refused(tmp_path, content):
    path = save(content, tmp_path)
    with pytest.raises(ValueError, match=re.escape(f"{path}: not a state_dict")):
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
