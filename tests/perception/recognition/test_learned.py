"""The learned recogniser: what it compares."""

import pytest
import torch
from rooms import grid_scene

from dirl.perception.backbones.patches import coarse
from dirl.perception.recognition import Learned
from dirl.scenes import make_world


@pytest.fixture(params=[True])
def world(request):
    """Rooms that look otherwise at each visit, with patches of that kind."""
    size = {"feature_width": 32, "patches": request.param, "looks": 2, "noise": 0.8}
    return make_world([grid_scene(4, 3, name=f"room_{seed}", seed=seed, **size) for seed in range(2)])


@pytest.fixture
def network(world):
    torch.manual_seed(0)
    untrained = Learned(weights="")
    untrained.measure(world.features, world.patches)
    return untrained.eval()


@pytest.fixture
def visits(world, network):
    """What is seen in each state."""
    return network.describe(world.features[world.surrounding], world.patches[world.surrounding])


def test_a_turn_of_both_visits_changes_nothing_and_a_turn_of_one_does(network, visits):
    seen, reference = visits[:6].split(3)
    found = network.log_odds(seen, reference)
    turned = network.log_odds(seen.roll(1, 1), reference.roll(1, 1))
    torch.testing.assert_close(found, turned, atol=1e-5, rtol=0)
    assert not torch.allclose(found, network.log_odds(seen.roll(1, 1), reference), atol=1e-3)


def test_panoramas_are_compared_by_all_that_pooled_features_tell_of_a_place(world, network, visits):
    """Their principal components are not whitened: scalar products are those of the centred features."""
    whole = network.whole(visits[:6])
    centred = world.features[world.surrounding[:6]] - network.mean
    torch.testing.assert_close(whole @ whole.mT, centred @ centred.mT, atol=1e-3, rtol=1e-3)


def test_scores_are_the_log_odds_of_every_two_in_blocks_of_any_size(network, visits, monkeypatch):
    seen, references = visits[:5], visits[:7]
    wanted = torch.stack([torch.stack([network.log_odds(a, b) for b in references]) for a in seen])
    torch.testing.assert_close(network.scores(seen, references), wanted, atol=1e-5, rtol=0)
    monkeypatch.setattr("dirl.perception.recognition.learned.PAIRS_AT_ONCE", 10)
    torch.testing.assert_close(network.scores(seen, references), wanted, atol=1e-5, rtol=0)


def test_a_photo_is_compared_with_the_views_beside_it_too(network, visits):
    seen, photo = visits[:1], visits[1:2, :1]
    beside = seen.clone()
    beside[:, 3] = visits[3, 3]  # the view on the left
    assert network.log_odds(seen, photo) != network.log_odds(beside, photo)
    behind = seen.clone()
    behind[:, 2] = beside[:, 3]
    assert network.log_odds(seen, photo) == network.log_odds(behind, photo)


@pytest.mark.parametrize("world", ["fine"], indirect=True)
def test_what_has_no_fine_patches_is_compared_by_its_cells(world, network, visits):
    seen, few = visits, network.describe(world.features[world.surrounding], coarse(world.patches[world.surrounding]))
    torch.testing.assert_close(network.scores(seen, seen), network.scores(few, few), atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(network.scores(few, few[:, :1]), network.scores(seen, few[:, :1]), atol=1e-4, rtol=1e-4)


def test_the_weights_of_the_package_are_calibrated_and_need_the_patches_of_its_encoder():
    network = Learned()
    assert not torch.equal(network.calibration, torch.tensor([[1.0, 0.0], [1.0, 0.0]]))
    assert not network.training
    assert network.photo.trained
    with pytest.raises(ValueError, match=r"^recogniser=learned compares .* 1280 features .*encoder=efficientnet_lite0"):
        network.describe(torch.zeros(3, 2048))


def test_a_view_that_shows_nothing_is_no_evidence_that_a_photo_was_taken_elsewhere():
    network = Learned()
    patches = torch.randn(2, 4, 48, 96, generator=torch.Generator().manual_seed(0))
    patches[1, 0] = patches[1, 0, :1] + 0.1 * patches[1, 0]  # of one colour, but for noise
    described = network.describe(torch.zeros(2, 4, 1280), patches)
    odds = network.scores(described, described[:1, :1])
    assert odds[0].isfinite().all()
    assert (odds[1] == -torch.inf).all()
    assert network.scores(described.roll(1, 1), described[:1, :1]).isfinite().all()  # aside it is


def test_weights_that_cannot_be_used_are_named(network, tmp_path):
    junk, none = tmp_path / "junk.pt", tmp_path / "none.pt"
    junk.write_bytes(b"junk")
    reasons = {none: "there is no such file$", junk: "torch cannot read it as weights"}
    short = {name: value[..., :1] for name, value in network.state_dict().items()}
    for reason, stored in {"is no state_dict": [1, 2], "are weights of another network": short}.items():
        torch.save(stored, tmp_path / reason)
        reasons[tmp_path / reason] = reason
    for file, reason in reasons.items():
        with pytest.raises(ValueError, match=rf"^{file}: {reason}"):
            Learned(weights=str(file))
