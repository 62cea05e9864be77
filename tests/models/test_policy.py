"""The policy of figure 2: encoder, layers of each scene, operators, an optional memory; the features that it reads."""

import pytest
import torch
from networks import FEATURES, SCENES, SURROUNDING, batch_of, make_policy, seen, standardised_policy
from torch import nn
from torchrl.modules import set_recurrent_mode

from dirl.models import (
    ActorCriticHeads,
    FeatureTable,
    ObservationTable,
    feature_statistics,
    initial_state,
    recurrent_keys,
    whitening,
)
from dirl.models import policy as policy_module
from dirl.models.policy import SceneLinear, SceneTrunks

OUTPUTS = ("hidden", "logits", "state_value")


@pytest.mark.parametrize("cached", [False, True])
def test_torchrls_operators_compute_what_the_network_computes(cached):
    policy, given = standardised_policy(), batch_of(*seen())
    expected = policy(given.copy())
    if cached:
        policy.cache(SURROUNDING)
    calls = []
    policy.encoder.embedding.register_forward_hook(lambda *_: calls.append(1))
    out = policy.operator()(given)
    for key in ("logits", "state_value"):
        torch.testing.assert_close(out[key], expected[key])
    chosen = expected["logits"].log_softmax(-1).gather(-1, out["action"].unsqueeze(-1)).squeeze(-1)
    torch.testing.assert_close(out["action_log_prob"], chosen)
    assert len(calls) == 2  # once for observations, once for goals


def walked(policy, steps, begins):
    """Step by step: what a policy with memory writes for ``[B, T]``, and the batch as a rollout would hold it."""
    batch, outputs = [], []
    state = initial_state(policy, len(begins), torch.device("cpu"))
    for time in range(steps):
        views, goal_views, scene = seen(seed=time, rows=len(begins))
        state = {key: value.where(~begins[:, time, None, None], 0) for key, value in state.items()}  # as a primer does
        given = batch_of(views, goal_views, scene % 2).update({"is_init": begins[:, time : time + 1], **state})
        batch.append(given.copy())
        outputs.append(policy(given).select(*OUTPUTS))
        state = {key: given["next", key] for key in recurrent_keys(policy)}
    return torch.stack(batch, 1), torch.stack(outputs, 1)


def test_a_memory_makes_of_whole_episodes_what_it_makes_step_by_step():
    remembering = standardised_policy(memory=True)
    remembering.cache(SURROUNDING)
    begins = torch.zeros(6, 9, dtype=torch.bool)
    begins[:, 0] = True
    begins[1, 4] = begins[3, 1] = begins[3, 2] = begins[5, 8] = True
    batch, stepped = walked(remembering, 9, begins)
    with set_recurrent_mode(True):
        whole = remembering(batch)
    for key in OUTPUTS:
        torch.testing.assert_close(whole[key], stepped[key])


@pytest.mark.parametrize("late", [False, True])
@pytest.mark.parametrize("layers", [kind(SCENES, lambda: nn.Linear(5, 3)) for kind in (SceneTrunks, SceneLinear)])
@pytest.mark.parametrize("scene", [[1, 1, 1, 1, 1, 1], [2, 0, 0, 2, 0, 2]])
def test_each_row_goes_through_the_layer_of_its_scene(layers, scene, late, monkeypatch):
    monkeypatch.setattr(policy_module, "reading_waits", lambda tensor: late)  # as on a GPU, or not
    layers.sorts = True
    rows = torch.randn(6, 5)
    expected = torch.stack([layers.scenes[SCENES[s]](row) for row, s in zip(rows, scene, strict=True)])
    torch.testing.assert_close(layers(rows, torch.tensor(scene)), expected)


def test_weights_carry_the_names_of_scenes_and_are_as_many_as_published():
    made = make_policy(torch.zeros(1, 2048), ["a", "b", "c", "d"], width=512)
    assert sum(value.numel() for value in made.parameters()) == 5_780_500
    assert "value.scenes.kitchen.weight" in ActorCriticHeads(SCENES, 5, 4, 3).state_dict()
    assert "scenes.v1_0.weight" in SceneTrunks(["v1.0"], lambda: nn.Linear(1, 1)).state_dict()


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


def test_pooled_features_become_principal_components_and_patches_stay(monkeypatch):
    """Of many states in blocks, with the components of a sample of them; every state has a row."""
    torch.manual_seed(0)
    pooled, patches = torch.randn(50, 3) @ torch.randn(3, 6) + 2, torch.randn(50, 2, 2)
    table = FeatureTable(pooled, *whitening(pooled, 5), patches=patches)
    assert (table.inputs, table.width) == (6 + 4, 3 + 4)  # the features span three dimensions
    torch.testing.assert_close(table.known[:, :3].T.cov(), torch.eye(3), atol=1e-4, rtol=0)
    assert torch.equal(table.known[:, 3:], patches.flatten(1))
    assert sorted(table.state_dict()) == ["axes", "mean", "std"]
    whole = FeatureTable(pooled, *whitening(pooled[::3], 2), patches=patches).table
    monkeypatch.setattr("dirl.models.features.SAMPLED", 17)
    monkeypatch.setattr("dirl.models.features.ROWS_AT_ONCE", 7)
    torch.testing.assert_close(FeatureTable(pooled, *whitening(pooled, 2), patches=patches).table, whole)


FEW = torch.tensor([[0, 1, 2, 0], [1, 2, 0, 1], [2, 0, 1, 2]])
"""What surrounds each of three states."""


def rotated(surrounding, states=3):
    features = torch.randn(states, FEATURES, generator=torch.Generator().manual_seed(2))
    return ObservationTable(FeatureTable(features, *feature_statistics(features)), surrounding, 4)


@pytest.mark.parametrize("surrounding", [FEW, None], ids=["surrounding", "sequential"])
def test_a_layer_does_the_same_to_the_few_coordinates_that_observations_span_as_to_features(surrounding):
    table, weight = rotated(surrounding), torch.randn(5, 4 * FEATURES)
    assert table.width == 2  # standardised, three states span two dimensions
    assert rotated(SURROUNDING, 30).width == 4 * FEATURES
    views = FEW if surrounding is not None else FEW.flip(0).roll(1, 1)
    features, coordinates = table.table[views].flatten(1), table(views).flatten(1)
    torch.testing.assert_close(coordinates @ table.narrow(weight).T, features @ weight.T)
    narrow = torch.randn(5, coordinates.shape[1])
    torch.testing.assert_close(features @ table.widen(narrow).T, coordinates @ narrow.T)
    torch.testing.assert_close(table.narrow(table.widen(narrow)), narrow)
    other = rotated(surrounding)
    other.coordinates.neg_()  # as another machine might find them; a training goes on in the axes that it began in
    other.load_state_dict(table.state_dict())
    assert torch.equal(other(views), table(views))
