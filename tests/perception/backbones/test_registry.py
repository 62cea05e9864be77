"""Encoders: which one a name stands for, what it writes of itself, and features of any width through the pipeline."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from commands import train_config
from refusals import refused
from rooms import grid_scene

from dirl.models.build import feature_table
from dirl.perception.backbones import EncoderError, ViewEncoder, load_encoder, registry
from dirl.perception.backbones.encoder import reduced
from dirl.perception.backbones.patches import coarse
from dirl.perception.backbones.registry import encode_all, encoded_as
from dirl.scenes import make_world, read_dump, write_dump
from dirl.scenes.views import encode as webp

VIEWS = torch.from_numpy(np.random.default_rng(0).integers(0, 256, (5, 30, 40, 3), np.uint8))


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


def test_what_an_encoder_cannot_do_is_told_in_one_line():
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


def test_kept_features_are_used_only_if_they_are_of_this_encoder(tmp_path, monkeypatch):
    views = [webp(np.full((30, 40, 3), 9 * state, np.uint8)) for state in range(8)]
    write_dump(tmp_path / "room.h5", grid_scene(2, 1), views)
    scene, extractor = read_dump(tmp_path / "room.h5"), load_encoder("resnet50_small").extractor
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    first = encoded_as(scene, extractor, patches=False)
    (kept,) = (tmp_path / "dirl").iterdir()
    monkeypatch.setattr(registry, "encode_all", lambda *_: pytest.fail("is not kept"))
    assert np.array_equal(encoded_as(scene, extractor, patches=False).features, first.features)
    write_dump(kept, replace(first, views=None), feature_attributes={"extractor": "another"})
    with pytest.raises(pytest.fail.Exception, match="is not kept"):
        encoded_as(scene, extractor, patches=False)


def test_wide_views_are_reduced_before_they_are_encoded_but_not_in_tours(tmp_path, monkeypatch):
    sharp = np.random.default_rng(0).integers(0, 256, (8, 60, 80, 3), np.uint8)
    write_dump(tmp_path / "room.h5", grid_scene(2, 1), [webp(view) for view in sharp])
    scene, extractor = read_dump(tmp_path / "room.h5"), load_encoder("resnet50_small").extractor
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
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
