"""Encoders that a navigator loads by name: compared by what they say of themselves."""

import json
import warnings

import numpy as np
import pytest
import torch
from rooms import grid_scene
from shown_goals import trained

from dirl import Navigator
from dirl.agent.navigator import NavigatorError
from dirl.perception.backbones import ResNet50, load_encoder
from dirl.scenes import make_world

IMAGES = np.random.default_rng(0).integers(0, 256, (4, 40, 50, 3), np.uint8)


@pytest.fixture(scope="module")
def resnet50():
    return load_encoder("resnet50")


@pytest.fixture(scope="module")
def run(tmp_path_factory, resnet50):
    """The folder of a run on features that claim to be the shipped encoder's."""
    return finished_run(tmp_path_factory.mktemp("run"), resnet50.extractor, 2048)


def finished_run(folder, extractor, width):
    """The folder of a run on features of that width which claim to be of that extractor."""
    trained(folder, make_world([grid_scene(feature_width=width, extractor=extractor)]))
    return folder


def test_an_encoder_is_loaded_by_name_and_compared_by_itself(run, resnet50):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        navigators = Navigator.load(run, "resnet50"), Navigator.load(run, resnet50), Navigator.load(run)
    other = IMAGES[::-1].copy()
    for navigator in navigators:
        navigator.reset(IMAGES)
        assert navigator.act(IMAGES).scores.matching == pytest.approx(1, abs=1e-5)
    expected = navigators[0].act(other).scores.matching
    assert expected < 0.999
    assert [one.act(other).scores.matching for one in navigators] == pytest.approx([expected] * 3, abs=1e-5)


def test_an_encoder_with_another_text_is_refused(run):
    with pytest.raises(NavigatorError, match=r"another extractor: '.*224x224.*', not '.*96x128.*'") as caught:
        Navigator.load(run, "resnet50_small")
    assert "\n" not in str(caught.value)
    with pytest.raises(NavigatorError, match=r"another extractor: '.*224x224.*', not '.*96x128.*'"):
        Navigator.load(run, load_encoder("resnet50_small"))


@pytest.mark.parametrize("source", ["huggingface", "torchvision"])
def test_an_encoder_of_another_package_is_loaded_by_name(source, tmp_path, monkeypatch):
    if source == "huggingface":
        transformers = pytest.importorskip("transformers")
        sizes = {"num_hidden_layers": 1, "num_attention_heads": 2, "intermediate_size": 8, "patch_size": 8}
        model = transformers.ViTModel(transformers.ViTConfig(hidden_size=24, image_size=32, **sizes))
        name = str(tmp_path / "vit")
        model.save_pretrained(name)
        settings = {"image_processor_type": "ViTImageProcessor", "size": {"height": 32, "width": 32}}
        (tmp_path / "vit" / "preprocessor_config.json").write_text(json.dumps(settings))
    else:
        name, backbone = source, ResNet50().eval()  # in place of weights that would be downloaded
        monkeypatch.setattr("dirl.perception.backbones.registry._torchvision_backbone", lambda: backbone)
    extractor = load_encoder(name)
    run = finished_run(tmp_path / "run", extractor.extractor, extractor(torch.from_numpy(IMAGES)).shape[1])
    navigator = Navigator.load(run, name)
    navigator.reset(IMAGES)
    assert navigator.act(IMAGES).scores.matching == pytest.approx(1, abs=1e-5)
    with pytest.raises(NavigatorError, match="another extractor"):
        Navigator.load(run)


def test_more_images_than_a_batch_are_encoded_in_parts(run, resnet50, monkeypatch):
    sizes = []

    def encode(images):
        sizes.append(len(images))
        return torch.ones(len(images), 2048)

    monkeypatch.setattr(
        "dirl.agent.loading.load_encoder", lambda *_, **options: type(resnet50)(encode, resnet50.attributes)
    )
    navigator = Navigator.load(run, "resnet50")
    navigator.reset(np.broadcast_to(IMAGES, (9, *IMAGES.shape)))
    assert sizes == [32, 4]
