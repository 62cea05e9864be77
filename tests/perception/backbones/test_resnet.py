import re

import pytest
import torch

from dirl.perception.backbones.resnet import ResNet50, load_backbone


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (None, "there is no such file"),
        (b"PK\x03\x04 cut short", "not a file of weights that torch can load"),
        ({"epoch": 3}, "are no weights of a ResNet-50"),
    ],
)
def test_a_file_without_weights_is_named(tmp_path, content, problem):
    path = tmp_path / "weights.pth"
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content is not None:
        torch.save(content, path)
    with pytest.raises(ValueError, match=re.escape(f"{path}: {problem}")):
        load_backbone(path)


def test_first_wrong_parameter_is_named(tmp_path):
    path, first = tmp_path / "weights.pth", "layer1.0.conv1.weight"
    # Each array is one number repeated, so that the file is small.
    weights = {name: torch.full((), 0.01).expand(value.shape) for name, value in ResNet50().state_dict().items()}
    wrong = {
        'Missing key.*"layer2.1.conv1.weight"': {
            name: value for name, value in weights.items() if not name.startswith("layer2.1")
        },
        'Missing key.*"conv1.weight"': {"module.conv1.weight": torch.zeros(1)},
        f"size mismatch for {first}": {**weights, first: torch.zeros(128, 64, 1, 1)},
        'Unexpected key.*"layer3.6.conv1.weight"': {**weights, "layer3.6.conv1.weight": torch.zeros(1)},
    }
    for problem, content in wrong.items():
        torch.save(content, path)
        with pytest.raises(ValueError, match=f"^{re.escape(str(path))}: are no weights of a ResNet-50 .*{problem}"):
            load_backbone(path)
