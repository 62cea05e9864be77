import re

import numpy as np
import pytest
import torch
from torch import nn

from dirl.perception.backbones.resnet import ResNet50, load_backbone, preprocess

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


def test_backbone_stays_frozen_inside_a_network_that_is_trained(backbone, views):
    network = nn.Sequential(backbone, nn.BatchNorm1d(2048)).train()
    before = {name: value.clone() for name, value in backbone.state_dict().items()}
    network(preprocess(views))
    assert all(torch.equal(value, before[name]) for name, value in backbone.state_dict().items())
    assert not any(module.training for module in backbone.modules())
    assert not any(parameter.requires_grad for parameter in backbone.parameters())
    assert network[1].training


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


def test_first_wrong_parameter_is_named(tmp_path, weights):
    first, expected = "layer1.0.conv1.weight", "expected floats [64, 64, 1, 1], found torch"
    cut = {name: value for name, value in weights.items() if not name.startswith("layer2.1")}
    wrong = {
        "'layer2.1.conv1.weight' is missing": cut,
        "'conv1.weight' is missing; the file's names begin with ['module.": {"module.conv1.weight": torch.zeros(1)},
        f"'{first}': {expected}.float32 [128, 64, 1, 1]": {**weights, first: torch.zeros(128, 64, 1, 1)},
        "'layer3.6.conv1.weight' is no parameter": {**weights, "layer3.6.conv1.weight": torch.zeros(1)},
    }
    for problem, content in wrong.items():
        path = save(content, tmp_path)
        with pytest.raises(ValueError, match=re.escape(f"{path}: {problem}")):
            load_backbone(path)
