import torch
from networks import FEATURES, SCENES, SURROUNDING, make_policy, plain, seen, standardised_policy

FEW = torch.tensor([[0, 1, 2, 0], [1, 2, 0, 1], [2, 0, 1, 2]])
"""What surrounds each of three states."""


def few_states():
    """A policy in a world of three states, far fewer than features."""
    return make_policy(torch.randn(3, FEATURES, generator=torch.Generator().manual_seed(2)), SCENES)


def columns(policy, surrounding):
    policy.cache(surrounding, principal=True)
    return policy.encoder.embedding.weight.shape[1]


def test_no_more_columns_than_the_features_span():
    # 30 states span all 28 dimensions.
    assert columns(standardised_policy(), SURROUNDING) == 4 * FEATURES
    assert columns(standardised_policy(), None) == 4 * FEATURES
    few = few_states()
    assert columns(few, FEW) == 3
    few.restore()
    assert few.encoder.embedding.weight.shape[1] == 4 * FEATURES
    assert columns(few, None) == 4 * 3


def change(policy):
    with torch.no_grad():
        weight = policy.encoder.embedding.weight
        weight.add_(0.1 * torch.randn(weight.shape, generator=torch.Generator().manual_seed(4)))


def test_what_was_learnt_stays_on_features():
    policy, (views, goal_views, _) = standardised_policy(), seen()
    policy.cache(SURROUNDING, principal=True)
    change(policy)
    fused, weights = policy.cached(views, goal_views), policy.plain_state_dict()
    policy.restore()
    torch.testing.assert_close(plain(policy, views, goal_views), fused)
    torch.testing.assert_close(policy.cached(views, goal_views), fused)
    torch.testing.assert_close(policy.plain_state_dict(), weights)
    assert policy.state_dict().keys() == weights.keys() == standardised_policy().state_dict().keys()


def test_nothing_is_learnt_of_what_the_states_never_show():
    few = few_states()
    before = few.encoder.embedding.weight.detach().clone()
    few.cache(FEW, principal=True)
    rows = few.features.table[FEW].flatten(-2)
    beside = torch.randn(4 * FEATURES, generator=torch.Generator().manual_seed(3))
    beside -= torch.linalg.lstsq(rows.T, beside).solution @ rows
    change(few)
    few.restore()
    assert not torch.allclose(few.encoder.embedding.weight @ rows.T, before @ rows.T, atol=1e-2)
    torch.testing.assert_close(few.encoder.embedding.weight @ beside, before @ beside, atol=1e-5, rtol=1e-4)


def test_the_weights_of_a_training_go_on_in_the_axes_they_were_learnt_in():
    policy, other = standardised_policy(), standardised_policy()
    for made in (policy, other):
        made.cache(SURROUNDING, principal=True)
    change(policy)
    with torch.no_grad():
        other.cached.axes.table.neg_()  # as another machine might find them
    other.load_state_dict(policy.state_dict())
    views, goal_views, _ = seen()
    torch.testing.assert_close(other.cached(views, goal_views), policy.cached(views, goal_views))
