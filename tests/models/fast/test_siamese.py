import copy

import pytest
import torch
from networks import SURROUNDING, WIDTH, embedded_rows, gradients, plain, seen, standardised_policy

from dirl.models.fast import caching
from dirl.models.fast.siamese import CachedSiamese
from dirl.training.objectives import TFRMSprop

FORMS = [
    pytest.param(surrounding, principal, late, id=f"{seen_as}-{axes}-{device}")
    for seen_as, surrounding in (("surrounding", SURROUNDING), ("sequential", None))
    for axes, principal in (("features", False), ("principal", True))
    for device, late in (("cpu", False), ("gpu", True))
]


@pytest.fixture
def policy():
    """Cached, on features."""
    made = standardised_policy()
    made.cache(SURROUNDING)
    return made


@pytest.mark.parametrize(("surrounding", "principal", "late"), FORMS)
def test_cached_it_computes_the_same(surrounding, principal, late, monkeypatch):
    monkeypatch.setattr(caching, "avoid_host_sync", lambda tensor: late)
    expected = standardised_policy()
    policy = copy.deepcopy(expected)
    policy.cache(surrounding, principal=principal)
    assert type(policy.cached) is CachedSiamese
    views, goal_views, _ = seen()
    if surrounding is None:
        views = views.flip(0).roll(1, 1)
        given = views
    else:
        given = views * torch.tensor([1, 0, 0, 0])  # the state alone says what is seen from it
    fused, wanted = policy.cached(given, goal_views), plain(expected, views, goal_views)
    assert fused.shape == (80, WIDTH)
    torch.testing.assert_close(fused, wanted)
    names = [name for name, _ in policy.encoder.named_parameters()]
    found = dict(zip(names, gradients(policy.encoder, fused), strict=True))
    for (name, _), gradient in zip(
        expected.encoder.named_parameters(), gradients(expected.encoder, wanted), strict=True
    ):
        if principal and name == "embedding.weight":
            gradient = policy.cached.axes.narrow(gradient)  # W = C V', so the gradient of C is that of W in the axes
        torch.testing.assert_close(found[name], gradient)
    torch.testing.assert_close(policy.plain_state_dict(), expected.state_dict())
    with policy.cached.frozen(), torch.no_grad():
        torch.testing.assert_close(policy.cached(given, goal_views), wanted)
    # Who computes features of their own, as a loss on images does, calls the encoder itself.
    torch.testing.assert_close(plain(policy, views, goal_views), wanted)


def test_each_distinct_row_is_embedded_once(policy):
    views, goal_views, _ = seen()
    calls = embedded_rows(policy.encoder)
    policy.cached(views, goal_views)
    assert sum(calls) <= len(views.unique(dim=0)) + len(goal_views.unique(dim=0)) == 16


def test_caching_gives_the_same_output_and_gradients_after_a_rollout(policy):
    (views, goal_views, _), (more_views, more_goal_views, _) = seen(), seen(seed=1)
    everything = torch.cat([views, more_views]), torch.cat([goal_views, more_goal_views])
    wanted = plain(policy, *everything)
    wanted_gradients = gradients(policy.encoder, wanted)
    with policy.cached.caching():
        with torch.no_grad():
            for half in (slice(40), slice(40, None)):
                rollout = policy.cached(views[half], goal_views[half])
                torch.testing.assert_close(rollout, wanted[:80][half])
        # The loss sees what the rollout saw and something new.
        again = policy.cached(*everything)
    torch.testing.assert_close(again, wanted)
    torch.testing.assert_close(gradients(policy.encoder, again), wanted_gradients)


def test_caching_embeds_no_observation_twice(policy):
    views, goal_views, _ = seen()
    calls = embedded_rows(policy.encoder)
    with policy.cached.caching():
        with torch.no_grad():
            policy.cached(views[:3], goal_views[:3])
            policy.cached(views, goal_views)
        policy.cached(views, goal_views)
        policy.cached(goal_views, views)
    assert sum(calls) <= len(views.unique(dim=0)) + len(goal_views.unique(dim=0)) == 16


@pytest.mark.parametrize("principal", [False, True])
@pytest.mark.parametrize("optimiser", [torch.optim.Adam, TFRMSprop])
def test_caching_forgets_what_older_weights_embedded(optimiser, principal):
    policy, (views, goal_views, _) = standardised_policy(), seen()
    policy.cache(SURROUNDING, principal=principal)
    optimiser = optimiser(policy.encoder.parameters(), lr=0.1)
    with policy.cached.caching():
        for _ in range(2):
            with torch.no_grad():
                policy.cached(views, goal_views)
            fused, restored = policy.cached(views, goal_views), copy.deepcopy(policy)
            restored.restore()
            torch.testing.assert_close(fused, plain(restored, views, goal_views))
            gradients(policy.encoder, fused)
            optimiser.step()


@pytest.mark.parametrize("context", ["caching", "frozen"])
def test_after_the_context_the_weights_count_again(policy, context):
    views, goal_views, _ = seen()

    def leave_by_an_error():
        with torch.no_grad(), getattr(policy.cached, context)():
            policy.cached(views, goal_views)
            raise KeyError

    with pytest.raises(KeyError):
        leave_by_an_error()
    calls = embedded_rows(policy.encoder)
    policy.cached(views, goal_views)
    assert calls, "the context still answers"
    with torch.no_grad():
        policy.encoder.embedding.weight.add_(1)
        for manager in (torch.no_grad(), getattr(policy.cached, context)()):
            with manager:
                torch.testing.assert_close(policy.cached(views, goal_views), plain(policy, views, goal_views))


def test_a_frozen_policy_answers_without_the_embedding(policy):
    views, goal_views, _ = seen()
    wanted = plain(policy, views, goal_views)
    calls = embedded_rows(policy.encoder)
    with policy.cached.frozen():
        projected = policy.cached(views, goal_views)
    torch.testing.assert_close(projected, wanted)
    assert calls == []
