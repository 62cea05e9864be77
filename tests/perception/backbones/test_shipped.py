"""The encoder that comes with the package is the one that made the built-in rooms."""

import hashlib

import h5py
import numpy as np
import pytest
import torch

from dirl.perception.backbones import load_encoder
from dirl.perception.backbones.resnet import DATA, PROVENANCE, WEIGHTS
from dirl.scenes import PUBLISHED_GOALS, load_scenes
from dirl.scenes.catalogue import ROOMS


@pytest.fixture(scope="module")
def encoder():
    return load_encoder()


@pytest.mark.parametrize("name", PUBLISHED_GOALS)
def test_a_built_in_room_says_that_these_weights_made_its_features(encoder, name):
    assert load_scenes(name)[0].extractor == encoder.extractor
    with h5py.File(ROOMS / f"{name}.h5") as file:
        stored = dict(file["resnet_feature"].attrs)
    assert stored == encoder.attributes
    assert stored["provenance"] == PROVENANCE


@pytest.mark.parametrize(("name", "states"), [("bathroom_02", [0, 53, 179]), ("kitchen_02", [7, 675])])
def test_features_are_the_stored_ones_as_float16(encoder, name, states):
    (scene,) = load_scenes(name)
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
