import torch
from networks import SCENES, batch_of, make_policy, seen, standardised_policy

from dirl.models import FeatureTable, feature_statistics


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


def test_the_state_dict_keeps_mean_and_deviation_but_not_the_table():
    assert sorted(standardised_policy().features.state_dict()) == ["mean", "std"]


def test_a_loaded_network_standardises_as_the_one_that_was_saved():
    policy = standardised_policy()
    fresh = make_policy(policy.features.features, SCENES)
    assert not torch.equal(fresh.features.table, policy.features.table)
    fresh.load_state_dict(policy.state_dict())
    assert torch.equal(fresh.features.table, policy.features.table)
    found, expected = (made(batch_of(*seen())) for made in (fresh, policy))
    for key in ("logits", "state_value"):
        torch.testing.assert_close(found[key], expected[key])
