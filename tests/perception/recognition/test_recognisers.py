"""Recognisers: their scores, their tables in worlds, and what agents do with them."""

import pytest
import torch
from rooms import grid_scene

from dirl.agent.cameras import compare
from dirl.perception.recognition import NCC, Learned
from dirl.perception.recognition.recogniser import VisitScores, described_visits, panorama_odds
from dirl.scenes import make_world

BOTH = pytest.mark.parametrize("kind", [NCC, Learned])


def changing(noise=0.05, looks=2, width=64):
    rooms = [
        grid_scene(3, 2, name="a", goals=(0, 13), feature_width=width, patches=True, looks=looks, noise=noise),
        grid_scene(2, 2, name="b", goals=(5,), feature_width=width, seed=1, patches=True, looks=looks, noise=noise),
    ]
    return make_world(rooms)


@BOTH
@pytest.mark.parametrize("match", ["views", "front"])
def test_the_table_of_a_world_holds_what_the_recogniser_computes(kind, match):
    world, recogniser = changing(width=1280), kind()
    table = VisitScores(recogniser, world, match)
    visits = described_visits(recogniser, world, 1)
    pictures = world.pictures(1)
    references = visits[:, :1] if match == "front" else visits
    wanted = recogniser.fit(world.features[24:40], world.patches[24:40]).scores(visits, references)
    found = table(pictures.unsqueeze(0), pictures.unsqueeze(1))  # reference, seen
    torch.testing.assert_close(found, wanted, atol=1e-5, rtol=0)


@BOTH
def test_a_camera_sees_what_the_table_of_a_world_says(kind):
    """The same walk, compared by the table and from the features."""
    world, recogniser = changing(width=1280), kind()
    table, ids_seen, views_seen = VisitScores(recogniser, world), [], []
    own = recogniser.fit(world.features[:24], world.patches[:24])
    generator = torch.Generator().manual_seed(0)
    for _ in range(12):
        picture = torch.randint(24, (1,), generator=generator) + 40 * torch.randint(3, (1,), generator=generator)
        state, look = picture % 40, picture // 40
        ids = world.surrounding[state] + 40 * look.unsqueeze(-1)
        described = own.describe(world.features[ids], world.patches[ids])
        if ids_seen:
            by_table = table.of_visits(torch.stack(ids_seen, 1), ids)
            by_camera = compare(recogniser, torch.stack(views_seen, 1), described)
            torch.testing.assert_close(by_camera, by_table, atol=1e-5, rtol=0)
        ids_seen.append(ids)
        views_seen.append(described)


@pytest.mark.parametrize("views", [8, 4])
def test_a_panorama_is_found_again_with_its_heading_by_what_differs_within_the_place(views):
    common = 5 * torch.randn(32, generator=torch.Generator().manual_seed(0))
    places = common + torch.randn((1, 5, 8, 32), generator=torch.Generator().manual_seed(1))
    wanted = places[:, 2].roll(-3, 1)[:, :: 8 // views]
    odds = panorama_odds(places, wanted + 0.5 * torch.randn(wanted.shape, generator=torch.Generator().manual_seed(2)))
    assert odds.flatten().argmax() == 2 * 8 + 3
    assert ((odds > 3).sum(), odds.shape) == (1, (1, 5, 8))


def test_what_many_views_of_a_place_share_says_little_of_a_panorama():
    """Light differs from place to place and from day to day, more than anything else."""
    generator = torch.Generator().manual_seed(1)
    places = torch.randn((1, 5, 8, 32), generator=generator)
    wanted = places[:, 2].roll(-3, 1).clone()
    places[..., :2] += 8 * torch.randn((1, 5, 1, 2), generator=generator)
    wanted[..., :2] += 8 * torch.randn((1, 1, 2), generator=generator)
    assert panorama_odds(places, wanted).flatten().argmax() == 2 * 8 + 3


def test_the_more_panoramas_are_known_the_more_alike_they_have_to_be_and_a_goal_counts_places_unseen():
    seen, wanted = torch.randn(1, 5, 8, 32), torch.randn(1, 8, 32)
    few, many = (seen.repeat(1, times, 1, 1) for times in (20, 40))  # the views are whitened alike
    assert ((panorama_odds(few, wanted) - panorama_odds(many, wanted)[:, :100]) > 0.8).all()
    assert torch.allclose(panorama_odds(seen, wanted, few), panorama_odds(seen, wanted, many), atol=0.2)


class Whole(NCC):
    """Compares panoramas by the first features of each view."""

    def whole(self, described):
        return described[..., :16]


def test_panoramas_are_compared_in_worlds_as_cameras_compare_them():
    world = make_world([grid_scene(2, 2, headings=8, goals=(0,), feature_width=64)])
    around = world.panoramas()
    seen, visit = around[None, [0, 9, 17]], around[None, 12]
    for recogniser in (Whole(), NCC()):
        found = VisitScores(recogniser, world).of_visits(seen, visit)
        assert found.flatten().argmax() == 8 + 3
        assert torch.allclose(found, compare(recogniser, world.features[seen], world.features[visit]), atol=1e-5)
    # By correlation it is the mean of each four views, 90 degrees apart.
    fours = [(world.features[visit[:, ring::2]], world.features[seen[:, 1, ring::2]]) for ring in range(2)]
    assert torch.allclose(found[0, 1, 0], torch.stack([NCC().scores(*four) for four in fours]).mean(), atol=1e-5)


def test_where_views_return_a_match_leaves_no_doubt():
    world = make_world([grid_scene(3, 2, feature_width=64)])
    exact, visits = NCC(returned=0.98), described_visits(NCC(), world, 0)
    assert exact.calibrated
    assert not NCC().calibrated
    same = torch.eye(len(visits), dtype=torch.bool)
    assert torch.equal(exact.scores(visits, visits), torch.where(same, 20.0, -20.0))
    assert torch.equal(exact.scores(visits, visits[:, :1]), torch.where(same, 20.0, -20.0))
