import pytest
import torch
from networks import FEATURES, SCENES, SURROUNDING, make_policy, standardised_policy

from dirl.models import FeatureTable, ObservationTable, feature_statistics, whitening


def test_features_are_standardised_dimension_by_dimension():
    features = torch.tensor([[1.0, 5.0], [3.0, 5.0], [5.0, 5.0]])
    mean, std = feature_statistics(features)
    # The second feature never changes: its deviation is taken as one.
    assert mean.tolist() == [3, 5]
    assert std.tolist() == [2, 1]
    table = FeatureTable(features, mean, std)
    assert table(torch.tensor([[2, 0]])).tolist() == [[[1, 0], [-1, 0]]]
    assert (len(table), table.width) == (3, 2)
    assert torch.equal(FeatureTable(features)(torch.arange(3)), features)


def test_a_loaded_network_standardises_as_the_one_that_was_saved():
    policy = standardised_policy()
    fresh = make_policy(policy.features.features, SCENES)
    assert not torch.equal(fresh.features.table, policy.features.table)
    fresh.load_state_dict(policy.state_dict())
    assert torch.equal(fresh.features.table, policy.features.table)


def test_a_view_that_is_not_known_is_zeros_whatever_the_noise(monkeypatch):
    """In a large world several states share theirs."""
    monkeypatch.setattr("dirl.models.features.NOISE_ROWS", 2)
    table = FeatureTable(torch.randn(3, 4), torch.ones(4), torch.full((4,), 2.0))
    assert table(torch.tensor([3, 3])).tolist() == [[0] * 4] * 2
    with table.noisy(0.5):
        noisy = table(torch.tensor([0, 1, 2, 3]))
    added = noisy - table.table
    torch.testing.assert_close(added[0], added[2])
    assert added[:3].abs().min() > 0
    assert not torch.equal(added[0], added[1])
    assert noisy[3].tolist() == [0] * 4
    assert torch.equal(table(torch.tensor([0])), table.known[:1])


def test_pooled_features_become_principal_components_and_patches_stay():
    torch.manual_seed(0)
    pooled, patches = torch.randn(50, 3) @ torch.randn(3, 6) + 2, torch.randn(50, 4)
    table = FeatureTable(pooled, *whitening(pooled, 5), patches=patches.view(50, 2, 2))
    assert (table.inputs, table.width) == (6 + 4, 3 + 4)  # the features span three dimensions
    torch.testing.assert_close(table.known[:, :3].T.cov(), torch.eye(3), atol=1e-4, rtol=0)
    assert torch.equal(table.known[:, 3:], patches)
    assert sorted(table.state_dict()) == ["axes", "mean", "std"]


def test_many_states_are_standardised_in_blocks_and_sampled_for_their_components(monkeypatch):
    """The components of a sample are those of its states alone; every state has a row."""
    torch.manual_seed(0)
    pooled, patches = torch.randn(50, 3) @ torch.randn(3, 6) + 2, torch.randn(50, 2, 2)
    whole = FeatureTable(pooled, *whitening(pooled[::3], 2), patches=patches).table
    monkeypatch.setattr("dirl.models.features.SAMPLED", 17)
    monkeypatch.setattr("dirl.models.features.ROWS_AT_ONCE", 7)
    torch.testing.assert_close(FeatureTable(pooled, *whitening(pooled, 2), patches=patches).table, whole)


FEW = torch.tensor([[0, 1, 2, 0], [1, 2, 0, 1], [2, 0, 1, 2]])
"""What surrounds each of three states."""


def rotated(surrounding, states=3):
    features = torch.randn(states, FEATURES, generator=torch.Generator().manual_seed(2))
    return ObservationTable(features, *feature_statistics(features), None, surrounding, 4)


@pytest.mark.parametrize(("surrounding", "states", "columns"), [(FEW, 3, 2), (None, 3, 2), (SURROUNDING, 30, 28)])
def test_observations_have_no_more_coordinates_than_they_span(surrounding, states, columns):
    # Standardised, three states span two dimensions; 30 states span all 4 x 7 of their observations.
    assert rotated(surrounding, states).width == columns


@pytest.mark.parametrize("surrounding", [FEW, None], ids=["surrounding", "sequential"])
def test_a_layer_does_the_same_to_coordinates_as_to_features(surrounding):
    table, weight = rotated(surrounding), torch.randn(5, 4 * FEATURES)
    views = FEW if surrounding is not None else FEW.flip(0).roll(1, 1)
    features, coordinates = table.table[views].flatten(1), table(views).flatten(1)
    torch.testing.assert_close(coordinates @ table.narrow(weight).T, features @ weight.T)
    narrow = torch.randn(5, coordinates.shape[1])
    torch.testing.assert_close(features @ table.widen(narrow).T, coordinates @ narrow.T)
    torch.testing.assert_close(table.narrow(table.widen(narrow)), narrow)


def test_a_training_goes_on_in_the_axes_that_it_began_in():
    table, other = rotated(FEW), rotated(FEW)
    other.coordinates.neg_()  # as another machine might find them
    other.load_state_dict(table.state_dict())
    assert torch.equal(other(FEW), table(FEW))
