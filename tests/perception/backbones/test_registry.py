"""Encoders: which one a name stands for, what it writes of itself, and features of any width through the pipeline."""

import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from commands import train_config
from rooms import grid_scene

from dirl.models.build import feature_table
from dirl.perception.backbones import (
    EncoderError,
    ResNet50,
    ViewEncoder,
    load_encoder,
    preprocess,
    registry,
)
from dirl.perception.backbones.encoder import weights_hash
from dirl.perception.backbones.patches import coarse
from dirl.perception.backbones.registry import encode_all, encoded_as
from dirl.scenes import make_world, read_dump, write_dump
from dirl.scenes.views import encode as webp

VIEWS = torch.from_numpy(np.random.default_rng(0).integers(0, 256, (5, 30, 40, 3), np.uint8))


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """A file of ResNet-50 weights, random ones."""
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("weights") / "resnet.pth"
    torch.save(ResNet50().state_dict(), path)
    return path


@pytest.fixture(scope="module", params=["conv", "clip"])
def hub(request, tmp_path_factory):
    """The folder of a tiny Hugging Face model with random weights, and how wide its features are."""
    transformers = pytest.importorskip("transformers")
    transformers.utils.logging.disable_progress_bar()
    torch.manual_seed(1)
    folder = tmp_path_factory.mktemp(request.param)
    vit = {"hidden_size": 24, "num_hidden_layers": 1, "num_attention_heads": 2, "intermediate_size": 8}
    vit |= {"image_size": 32, "patch_size": 8}
    kind = "ConvNextImageProcessor" if request.param == "conv" else "ViTImageProcessor"
    size = {"shortest_edge": 32} if request.param == "conv" else {"height": 32, "width": 32}
    if request.param == "conv":
        sizes = {"embedding_size": 8, "hidden_sizes": [8, 16], "depths": [1, 1], "layer_type": "basic"}
        model, width = transformers.ResNetModel(transformers.ResNetConfig(**sizes)), 16
    else:
        text = {"hidden_size": 16, "num_hidden_layers": 1, "num_attention_heads": 2, "intermediate_size": 8}
        text |= {"vocab_size": 9, "bos_token_id": 1, "eos_token_id": 2, "pad_token_id": 0}
        config = transformers.CLIPConfig(text_config=text, vision_config=vit, projection_dim=8)
        model, width = transformers.CLIPModel(config), 24
    model.save_pretrained(folder)
    settings = f'{{"image_processor_type": "{kind}", "size": {size}, "do_resize": true, "do_normalize": true}}'
    (folder / "preprocessor_config.json").write_text(settings.replace("'", '"'))
    return folder, width


def room_with_views(path, height=30, width=40, **options):
    scene = replace(grid_scene(**options), features=None, extractor="none")
    rng = np.random.default_rng(3)
    views = [webp(rng.integers(0, 256, (height, width, 3), np.uint8)) for _ in range(len(scene))]
    write_dump(path, scene, views, attributes={"note": "kept"})
    return read_dump(path)


def test_a_file_is_resnet_50_with_its_weights(weights):
    encoder = load_encoder(str(weights))
    backbone = ResNet50()
    backbone.load_state_dict(torch.load(weights, weights_only=True))
    torch.testing.assert_close(encoder(VIEWS), backbone(preprocess(VIEWS)), rtol=1e-4, atol=1e-5)
    assert encoder.attributes["weights"] == weights_hash(
        {k: v for k, v in torch.load(weights, weights_only=True).items() if not k.endswith("num_batches_tracked")}
    )
    assert encoder.extractor == "; ".join(encoder.attributes[key] for key in ("extractor", "preprocessing", "weights"))


def test_the_hash_is_of_the_values_not_of_the_file(weights, tmp_path):
    state = torch.load(weights, weights_only=True)
    torch.save({"fc.weight": torch.zeros(3), **dict(reversed(state.items()))}, tmp_path / "other.pth")
    assert load_encoder(str(tmp_path / "other.pth")).extractor == load_encoder(str(weights)).extractor
    state["conv1.weight"][0, 0, 0, 0] += 1e-3
    torch.save(state, tmp_path / "changed.pth")
    assert load_encoder(str(tmp_path / "changed.pth")).extractor != load_encoder(str(weights)).extractor
    assert len(load_encoder(str(weights)).attributes["weights"].removeprefix("sha256:")) == 64


def test_a_quarter_of_the_digits_moves_features_by_a_hundredth(weights):
    exact, rounded = (load_encoder(str(weights), precision=precision)(VIEWS) for precision in ("float32", "bfloat16"))
    assert rounded.dtype == torch.float32
    assert 0 < (exact - rounded).norm() < 0.05 * exact.norm()


def test_only_lite0_gives_fine_patches():
    message = r"^fine_patches=true: encoder=resnet50_small has none; choose encoder=efficientnet_lite0"
    with pytest.raises(EncoderError, match=message):
        load_encoder("resnet50_small", fine_patches=True)


def test_a_policy_reads_the_means_of_fine_patches():
    config = train_config("system=any_goal")
    tables = []
    for patches in ("fine", True):
        world = make_world([grid_scene(4, 3, patches=patches)])
        if patches == "fine":
            few = coarse(world.patches)
        else:
            world = replace(world, patches=few)
        tables.append(feature_table(config, world).patches)
    assert tables[0].shape[1:] == (8, 96)
    assert torch.equal(*tables)


def test_patches_are_the_same_beside_any_encoder(weights):
    alone, beside = (load_encoder(name, patches=True) for name in ("resnet50_small", str(weights)))
    small, patches = alone.forward_patches(VIEWS)
    features, again = beside.forward_patches(VIEWS)
    assert patches.shape == (5, 8, 96)
    torch.testing.assert_close(patches, again, rtol=1e-3, atol=1e-3)
    torch.testing.assert_close(features, load_encoder(str(weights))(VIEWS), rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(small, load_encoder("resnet50_small")(VIEWS), rtol=1e-4, atol=1e-5)
    found = encode_all(alone, VIEWS.numpy(), 5, "here")
    assert found.patches.dtype == np.float16
    np.testing.assert_allclose(found.patches, patches, rtol=2e-3, atol=2e-3)


def test_a_hugging_face_model_gives_the_mean_of_its_last_hidden_state(hub):
    from transformers import AutoImageProcessor, AutoModel

    folder, width = hub
    encoder = load_encoder(str(folder))
    features = encoder(VIEWS)
    assert (features.shape, features.dtype) == ((5, width), torch.float32)
    model = AutoModel.from_pretrained(folder).eval()
    images = AutoImageProcessor.from_pretrained(folder)(list(VIEWS.numpy()), return_tensors="pt")
    with torch.no_grad():
        hidden = getattr(model, "vision_model", model)(**images).last_hidden_state
    mean = hidden.mean((2, 3)) if hidden.ndim == 4 else hidden.mean(1)
    torch.testing.assert_close(features, mean)
    assert "of transformers, mean of the last hidden state" in encoder.attributes["extractor"]
    assert '"size"' in encoder.attributes["preprocessing"]
    assert load_encoder(str(folder)).extractor == encoder.extractor  # also where a pooler gets random weights


def test_a_model_whose_weights_are_incomplete_is_refused(tmp_path):
    transformers = pytest.importorskip("transformers")
    from safetensors.torch import load_file, save_file

    sizes = {"embedding_size": 8, "hidden_sizes": [8], "depths": [1], "layer_type": "basic"}
    transformers.ResNetModel(transformers.ResNetConfig(**sizes)).save_pretrained(tmp_path)
    (tmp_path / "preprocessor_config.json").write_text('{"image_processor_type": "ViTImageProcessor"}')
    state = load_file(tmp_path / "model.safetensors")
    lost = next(name for name in state if name.endswith("convolution.weight"))
    del state[lost]
    save_file(state, tmp_path / "model.safetensors", {"format": "pt"})
    with pytest.raises(EncoderError, match=f"'{lost}' is missing in its weights, which would be random"):
        load_encoder(str(tmp_path))


@pytest.mark.parametrize(
    ("name", "missing", "says"),
    [
        ("nowhere.pth", None, "nowhere.pth: there is no such file"),
        ("some/model", "transformers", r"encoder=some/model: is no file of weights, .*: pip install 'dirl\[hf\]'"),
        ("no/such-model", None, "encoder=no/such-model: neither a file of weights nor a Hugging Face vision model"),
    ],
)
def test_an_encoder_that_cannot_be_had_is_told_in_one_line(monkeypatch, name, missing, says):
    # The variable of this name is read at the import, which may have been in another test.
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    if missing is not None:
        monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(ValueError, match=says) as caught:
        load_encoder(name)
    assert "\n" not in str(caught.value)


def counting(width=3):
    return ViewEncoder(lambda views: views.float().mean((1, 2))[:, :1].expand(-1, width), {"extractor": "mean red"})


@pytest.mark.parametrize("state", [33])
def test_views_that_cannot_be_encoded_name_the_state(state):
    views = [np.zeros((3, 4, 3), np.uint8) for _ in range(36)]
    views[state] = np.zeros((4, 4, 3), np.uint8)
    with pytest.raises(EncoderError, match=rf"^here: state {state} has a view \(4, 4, 3\), state 0 one \(3, 4, 3\)"):
        encode_all(counting(), views, 36, "here")
    views[state] = np.full((3, 4, 3), 255, np.uint8)
    spoilt = ViewEncoder(lambda v: torch.where(v.float().mean((1, 2)) > 254, torch.nan, 1.0), {})
    with pytest.raises(EncoderError, match=f"^here: state {state}: its features are not finite"):
        encode_all(spoilt, views, 36, "here")


def test_kept_features_are_used_only_if_they_are_of_this_encoder(tmp_path, monkeypatch):
    views = [webp(np.full((30, 40, 3), 9 * state, np.uint8)) for state in range(24)]
    write_dump(tmp_path / "room.h5", grid_scene(), views)
    scene, extractor = read_dump(tmp_path / "room.h5"), load_encoder("resnet50_small").extractor
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    first = encoded_as(scene, extractor, patches=False)
    (kept,) = (tmp_path / "dirl").iterdir()
    monkeypatch.setattr(registry, "encode_scene", lambda *_: pytest.fail("is not kept"))
    assert np.array_equal(encoded_as(scene, extractor, patches=False).features, first.features)
    write_dump(kept, replace(first, views=None), feature_attributes={"extractor": "another"})
    with pytest.raises(pytest.fail.Exception, match="is not kept"):
        encoded_as(scene, extractor, patches=False)


def test_a_user_without_a_home_has_no_kept_features(tmp_path, monkeypatch, capsys):
    views = [webp(np.full((30, 40, 3), 9 * state, np.uint8)) for state in range(24)]
    write_dump(tmp_path / "room.h5", grid_scene(), views)
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.delenv("HOME")
    monkeypatch.setattr("pwd.getpwuid", {}.__getitem__)
    monkeypatch.chdir(tmp_path)
    extractor = load_encoder("resnet50_small").extractor
    assert encoded_as(read_dump(tmp_path / "room.h5"), extractor, patches=False).extractor == extractor
    assert "not kept: this user has no home directory" in capsys.readouterr().out
    assert [path.name for path in tmp_path.iterdir()] == ["room.h5"]
