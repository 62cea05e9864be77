"""Embedding once what many frames share, with encoders of any kind."""

import copy

import pytest
import torch
import torch.nn.functional as F
from hypothesis import given
from hypothesis import strategies as st
from networks import SURROUNDING, gradients, plain, seen, standardised_policy
from torch import nn

from dirl.envs.transforms import front_only
from dirl.models import ComparingEncoder, SiameseEncoder, distinct
from dirl.models.distinct import CachedEncoder, Keys, packable


@given(st.lists(st.lists(st.integers(0, 55_107), min_size=4, max_size=4), min_size=1, max_size=20))
def test_packed_rows_unpack_to_themselves(rows):
    view_ids, keys = torch.tensor(rows), Keys(55_108, 4)
    packed = keys.pack(view_ids)
    assert torch.equal(keys.unpack(packed), view_ids)
    assert len(packed.unique()) == len({tuple(row) for row in rows})
    assert packable(55_108, 4)
    assert not packable(55_109, 4)


class Attention(nn.Module):
    """An encoder of one's own that can be cached: its views attend to each other."""

    def __init__(self, num_features, width):
        super().__init__()
        self.query, self.value = nn.Linear(num_features, width), nn.Linear(num_features, width)
        self.last = nn.Bilinear(width, width, width)
        self.rows = []

    def embed(self, observation):
        self.rows.append(len(observation))
        query = self.query(observation)
        return ((query @ query.mT).softmax(-1) @ self.value(observation)).mean(-2)

    def fuse(self, embedding, goal_embedding):
        return F.elu(self.last(embedding, goal_embedding))

    def forward(self, observation, goal_observation):
        return self.fuse(self.embed(observation), self.embed(goal_observation))


class Comparing(ComparingEncoder):
    """An encoder that embeds goals otherwise than observations."""

    def __init__(self, num_features, width):
        super().__init__(num_features, (2, 2), width, comparison=9, projection=3, view_projection=4, pair_width=5)


def cached_and_plain(encoder, surrounding, front=False):
    expected = standardised_policy(encoder=encoder)
    policy = copy.deepcopy(expected)
    policy.cache(surrounding, front=front)
    return policy, expected


@pytest.mark.parametrize("encoder", [SiameseEncoder, Attention, Comparing])
@pytest.mark.parametrize("kind", ["surrounding", "sequential", "some photos"])
@pytest.mark.parametrize("late", [False, True], ids=["as on a CPU", "as on a GPU"])
def test_an_encoder_of_ones_own_computes_the_same_cached(encoder, kind, late, monkeypatch):
    monkeypatch.setattr(distinct, "reading_waits", lambda tensor: late)
    policy, expected = cached_and_plain(
        encoder, None if kind == "sequential" else SURROUNDING, front=kind == "some photos"
    )
    assert type(policy.cached) is CachedEncoder
    views, goal_views, _ = seen()
    if kind == "sequential":  # any four states can be seen together
        views, goal_views = (ids.flip(0).roll(1, 1) for ids in (views, goal_views))
    if kind == "some photos":  # goals of which only the view ahead is known
        photo = torch.arange(len(views)).unsqueeze(1) % 3 == 0
        goal_views = torch.where(photo, front_only(goal_views, len(SURROUNDING)), goal_views)
    fused, wanted = policy.cached(views, goal_views), plain(expected, views, goal_views)
    torch.testing.assert_close(fused, wanted)
    found = gradients(policy.encoder, fused)
    torch.testing.assert_close(found, gradients(expected.encoder, wanted), rtol=1e-3, atol=1e-4)
    with policy.cached.keeping(learns=True), torch.no_grad():
        for rows in (slice(0, 30), slice(20, 80)):
            torch.testing.assert_close(policy.cached(views[rows], goal_views[rows]), wanted[rows].detach())


def test_every_distinct_observation_is_embedded_once():
    policy, _ = cached_and_plain(Attention, SURROUNDING)
    views, goal_views, _ = seen()
    distinct = len(torch.cat([views, goal_views]).unique(dim=0))
    policy.cached(views, goal_views)
    assert policy.encoder.rows == [distinct]
    with policy.cached.keeping(learns=True), torch.no_grad():
        policy.cached(views[:9], goal_views[:9])
        policy.cached(views, goal_views)
        policy.cached(goal_views, views)
        assert sum(policy.encoder.rows) == 2 * distinct
    with policy.cached.keeping(learns=True):
        with torch.no_grad():
            policy.cached(views[:9], goal_views[:9])
        policy.cached(views, goal_views)  # a loss goes back through what the rollout embedded
        assert sum(policy.encoder.rows) == 3 * distinct


def test_a_loss_gets_the_gradients_of_what_a_rollout_embedded():
    policy, expected = cached_and_plain(SiameseEncoder, SURROUNDING)
    (views, goal_views, _), (more_views, more_goal_views, _) = seen(), seen(seed=1)
    everything = torch.cat([views, more_views]), torch.cat([goal_views, more_goal_views])
    wanted = gradients(expected.encoder, plain(expected, *everything))
    with policy.cached.keeping(learns=True):
        for _ in range(2):  # a graph is gone back through once
            with torch.no_grad():
                for half in (slice(40), slice(40, None)):
                    policy.cached(views[half], goal_views[half])
            torch.testing.assert_close(gradients(policy.encoder, policy.cached(*everything)), wanted)
    with policy.cached.keeping(learns=False):
        with torch.no_grad():
            policy.cached(views, goal_views)
        torch.testing.assert_close(gradients(policy.encoder, policy.cached(*everything)), wanted)


@pytest.mark.parametrize("learns", [True, False])
def test_after_the_context_nothing_is_kept(learns):
    policy, _ = cached_and_plain(Attention, SURROUNDING)
    views, goal_views, _ = seen()
    with torch.no_grad():
        with policy.cached.keeping(learns=learns):
            policy.cached(views, goal_views)
        policy.encoder.query.weight.data = policy.encoder.query.weight.data + 1  # without a trace in its version
        torch.testing.assert_close(policy.cached(views, goal_views), plain(policy, views, goal_views))
