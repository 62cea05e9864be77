"""Encoders that a navigator loads by name: compared by what they say of themselves."""

import warnings

import numpy as np
import pytest
import torch
from PIL import ExifTags, Image
from refusals import refused
from rooms import grid_scene
from shown_goals import trained

from dirl import Navigator
from dirl.perception.backbones import ResNet50, load_encoder, preprocess
from dirl.scenes import ACTIONS, make_world

IMAGES = np.random.default_rng(0).integers(0, 256, (4, 40, 50, 3), np.uint8)


@pytest.fixture(scope="module")
def resnet50():
    return load_encoder("resnet50_small")


def finished_run(folder, extractor):
    """The folder of a run on features which claim to be of that extractor."""
    trained(folder, make_world([grid_scene(feature_width=2048, extractor=extractor)]))
    return folder


@pytest.fixture(scope="module")
def run(tmp_path_factory, resnet50):
    return finished_run(tmp_path_factory.mktemp("run"), resnet50.extractor)


def test_an_encoder_is_loaded_by_name_and_compared_by_what_it_says_of_itself(run, resnet50):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        navigators = Navigator.load(run, "resnet50_small"), Navigator.load(run, resnet50), Navigator.load(run)
    other = IMAGES[::-1].copy()
    for navigator in navigators:
        navigator.reset(IMAGES)
        assert navigator.act(IMAGES).scores.matching == pytest.approx(1, abs=1e-5)
    expected = navigators[0].act(other).scores.matching
    assert expected < 0.999
    assert [one.act(other).scores.matching for one in navigators] == pytest.approx([expected] * 3, abs=1e-5)
    refused(r"another extractor: '.*96x128.*', not '.*224x224.*'", Navigator.load, run, "resnet50")


def test_an_encoder_from_a_file_of_weights_is_named(tmp_path):
    name, backbone, views = str(tmp_path / "resnet.pth"), ResNet50(), torch.from_numpy(IMAGES)
    torch.save(backbone.state_dict(), name)
    torch.testing.assert_close(load_encoder(name)(views), backbone(preprocess(views)), rtol=1e-4, atol=1e-5)
    run = finished_run(tmp_path / "run", load_encoder(name).extractor)
    navigator = Navigator.load(run, name)
    navigator.reset(IMAGES)
    assert navigator.act(IMAGES).scores.matching == pytest.approx(1, abs=1e-5)
    refused("which is no encoder of dirl; name it", Navigator.load, run)


def test_files_of_photos_are_read_upright_in_place_of_arrays(run, tmp_path):
    navigator, files = Navigator.load(run, "resnet50_small"), [tmp_path / f"{view}.png" for view in range(4)]
    for file, view in zip(files, IMAGES, strict=True):
        lying = Image.fromarray(view).transpose(Image.Transpose.ROTATE_90)
        lying.getexif()[ExifTags.Base.Orientation] = 6
        lying.save(file, exif=lying.getexif())
    navigator.reset(str(files[0]))
    seen = navigator.act(files)
    assert seen.scores.matching == pytest.approx(1, abs=1e-5)
    assert seen.action.name == ACTIONS[seen.action]
    refused(r"goal_images: .*gone\.jpg: No such file", navigator.reset, tmp_path / "gone.jpg")
    Image.fromarray(IMAGES[0, :20]).save(files[1])
    refused(r"images: the views of an agent are photos of one size; .*50x20", navigator.act, files)
