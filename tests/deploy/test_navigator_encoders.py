"""Encoders that a navigator loads by name: compared by what they say of themselves."""

import warnings

import numpy as np
import pytest
import torch
from commands import train_config
from rooms import grid_scene

from dirl import Navigator
from dirl.backbones import load_encoder
from dirl.deploy.navigator import NavigatorError
from dirl.runs.folder import Run
from dirl.scenes import make_world
from dirl.training.build import build_observation, build_policy, feature_table

IMAGES = np.random.default_rng(0).integers(0, 256, (4, 40, 50, 3), np.uint8)


@pytest.fixture(scope="module")
def resnet50():
    return load_encoder("resnet50")


@pytest.fixture(scope="module")
def run(tmp_path_factory, resnet50):
    """The folder of a run on features that claim to be the shipped encoder's."""
    folder = tmp_path_factory.mktemp("run")
    world = make_world([grid_scene(feature_width=2048, extractor=resnet50.extractor)])
    config = train_config("encoder.width=8", "heads.width=8")
    run = Run(folder, config)
    run.begin(world, build_observation(config, world).order)
    policy = build_policy(config, feature_table(config, world), world.names, world=world)
    run.finish({"frames": 0, "network": policy.state_dict()}, {})
    run.close()
    return folder


def test_an_encoder_is_loaded_by_name_and_compared_by_itself(run, resnet50):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        named, given = Navigator.load(run, "resnet50"), Navigator.load(run, resnet50)
    other = IMAGES[::-1].copy()
    for navigator in (named, given):
        navigator.reset(IMAGES)
    assert named.act(IMAGES).scores.matching == pytest.approx(1, abs=1e-5)
    assert named.act(other).scores.matching == pytest.approx(given.act(other).scores.matching, abs=1e-5)
    assert named.act(other).scores.matching < 0.999


def test_an_encoder_with_another_text_is_refused(run):
    with pytest.raises(NavigatorError, match=r"another extractor: '.*224x224.*', not '.*96x128.*'") as caught:
        Navigator.load(run, "resnet50_small")
    assert "\n" not in str(caught.value)
    with pytest.raises(NavigatorError, match=r"another extractor: '.*224x224.*', not '.*96x128.*'"):
        Navigator.load(run, load_encoder("resnet50_small"))


def test_more_images_than_a_batch_are_encoded_in_parts(run, resnet50, monkeypatch):
    sizes = []

    def encode(images):
        sizes.append(len(images))
        return torch.ones(len(images), 2048)

    monkeypatch.setattr(
        "dirl.deploy.loading.load_encoder", lambda name, device, patches: type(resnet50)(encode, resnet50.attributes)
    )
    navigator = Navigator.load(run, "resnet50")
    navigator.reset(np.broadcast_to(IMAGES, (9, *IMAGES.shape)))
    assert sizes == [32, 4]
