"""Encoders: embedding once what many frames share, and comparing by cosines."""

import copy

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from networks import SURROUNDING, gradients, plain, seen, standardised_policy
from outside import Product

from dirl.envs.transforms import front_only
from dirl.models import ComparingEncoder, SiameseEncoder, distinct
from dirl.models.comparing import SCALE
from dirl.models.distinct import CachedEncoder, Keys, packable


@given(st.lists(st.lists(st.integers(0, 55_107), min_size=4, max_size=4), min_size=1, max_size=20))
def test_packed_rows_unpack_to_themselves(rows):
    view_ids, keys = torch.tensor(rows), Keys(55_108, 4)
    packed = keys.pack(view_ids)
    assert torch.equal(keys.unpack(packed), view_ids)
    assert len(packed.unique()) == len({tuple(row) for row in rows})
    assert packable(55_108, 4)
    assert not packable(55_109, 4)


class Comparing(ComparingEncoder):
    """An encoder that embeds goals otherwise than observations."""

    def __init__(self, num_features, width):
        super().__init__(num_features, (2, 2), width, comparison=9, projection=3, view_projection=4, pair_width=5)


def cached_and_plain(encoder, surrounding, front=False):
    expected = standardised_policy(encoder=encoder)
    policy = copy.deepcopy(expected)
    policy.cache(surrounding, front=front)
    return policy, expected


@pytest.mark.parametrize(
    ("encoder", "kind"),
    [(SiameseEncoder, "sequential"), (Product, "surrounding"), (Comparing, "sequential"), (Comparing, "some photos")],
)
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
    policy, _ = cached_and_plain(Product, SURROUNDING)
    views, goal_views, _ = seen()
    rows = []
    policy.encoder.layer.register_forward_hook(lambda _, observations, __: rows.append(len(observations[0])))
    distinct = len(torch.cat([views, goal_views]).unique(dim=0))
    policy.cached(views, goal_views)
    assert rows == [distinct]
    with policy.cached.keeping(learns=True), torch.no_grad():
        policy.cached(views[:9], goal_views[:9])
        policy.cached(views, goal_views)
        policy.cached(goal_views, views)
        assert sum(rows) == 2 * distinct
    with policy.cached.keeping(learns=True):
        with torch.no_grad():
            policy.cached(views[:9], goal_views[:9])
        policy.cached(views, goal_views)  # a loss goes back through what the rollout embedded
        assert sum(rows) == 3 * distinct
        with torch.no_grad():
            policy.cached(views, goal_views)
    with torch.no_grad():
        policy.cached(views, goal_views)  # after the context nothing is kept: weights may have changed
    assert sum(rows) == 5 * distinct


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


POOLED, SHAPE = 5, (2, 3)


@pytest.fixture(params=[0, 5], ids=["read at once", "read by pair"])
def encoder(request):
    torch.manual_seed(0)
    sizes = {"width": 12, "comparison": 7, "projection": 4, "view_projection": 3, "pair_width": request.param}
    return ComparingEncoder(POOLED + 6, SHAPE, **sizes)


def views(count, seed=0):
    return torch.randn(count, 4, POOLED + 6, generator=torch.Generator().manual_seed(seed))


def test_the_goal_enters_by_the_cosines_of_its_patches_and_of_its_views_alone(encoder):
    seen, goals = views(6), (views(6, seed=1), views(6, seed=2))
    for projection in (encoder.patch_projection, encoder.view_projection):
        assert not torch.equal(*(encoder(seen, goal) for goal in goals))
        with torch.no_grad():
            projection.weight.zero_()
    assert torch.equal(*(encoder(seen, goal) for goal in goals))


def test_a_view_has_unit_vectors_and_one_that_is_not_known_no_cosine_with_anything(encoder):
    goal = views(6, seed=1)
    goal[:, 1:] = 0
    patches, of_views = (part.unflatten(1, (4, -1)) for part in encoder.embed_goal(goal).split(encoder.sizes, -1))
    assert patches[:, 1:].abs().max() == 0 == of_views[:, 1:].abs().max()
    torch.testing.assert_close(of_views[:, 0].norm(dim=-1), torch.ones(6))
    torch.testing.assert_close(patches[:, 0].unflatten(1, (SHAPE[0], -1)).norm(dim=-1), torch.ones(6, SHAPE[0]))


@pytest.mark.parametrize("encoder", [5], indirect=True)
def test_every_pair_of_views_is_read_by_the_same_layers(encoder):
    """Of an observed view and one of the goal the layers read what their patches have in common, wherever they are."""
    read = []
    encoder.pair_cosines.register_forward_hook(lambda _, rows, __: read.append(rows[0]))
    seen, goal = views(6), views(6, seed=1)
    encoder(seen, goal)
    encoder(seen.roll(1, 1), goal.roll(2, 1))
    first, turned = (rows.unflatten(1, (4, 4)) for rows in read)
    torch.testing.assert_close(turned, first.roll((1, 2), (1, 2)))
    patches = [
        torch.nn.functional.normalize(rows[3, view, POOLED:].view(2, 3) @ encoder.patch_projection.weight.T, dim=-1)
        for rows, view in ((seen, 1), (goal, 2))
    ]
    torch.testing.assert_close(first[3, 1, 2], SCALE * (patches[0] @ patches[1].T).flatten())
