"""Recognisers: their scores, their tables in worlds, and what agents do with them."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from rooms import grid_scene

from dirl.agent.cameras import compare
from dirl.perception.recognition import NCC, Learned
from dirl.perception.recognition.recogniser import TemplateStop, VisitScores, described_visits, ncc, panorama_odds
from dirl.scenes import make_world


@pytest.mark.parametrize("kind", [NCC, Learned])
@pytest.mark.parametrize("match", ["views", "front"])
def test_the_table_of_a_world_holds_what_the_recogniser_computes(kind, match):
    size = {"feature_width": 1280, "patches": True, "looks": 2}
    world, recogniser = make_world([grid_scene(3, 2, **size), grid_scene(2, 2, name="b", seed=1, **size)]), kind()
    table = VisitScores(recogniser, world, match)
    visits = described_visits(recogniser, world, 1)
    pictures = world.pictures(1)
    references = visits[:, :1] if match == "front" else visits
    wanted = recogniser.fit(world.features[24:40], world.patches[24:40]).scores(visits, references)
    found = table(pictures.unsqueeze(0), pictures.unsqueeze(1))  # reference, seen
    torch.testing.assert_close(found, wanted, atol=1e-5, rtol=0)


@pytest.mark.parametrize("views", [8, 4])
def test_a_panorama_is_found_again_with_its_heading_by_what_differs_within_the_place(views):
    """Light differs from place to place and from day to day, more than what is seen."""
    generator = torch.Generator().manual_seed(1)
    places = 5 * torch.randn(32, generator=generator) + torch.randn((1, 5, 8, 32), generator=generator)
    wanted = places[:, 2].roll(-3, 1)[:, :: 8 // views] + 0.5 * torch.randn((1, views, 32), generator=generator)
    places[..., :2] += 3 * torch.randn((1, 5, 1, 2), generator=generator)
    wanted[..., :2] += 3 * torch.randn((1, 1, 2), generator=generator)
    odds = panorama_odds(places, wanted)
    assert odds.flatten().argmax() == 2 * 8 + 3
    assert ((odds > 3).sum(), odds.shape) == (1, (1, 5, 8))


def test_the_more_panoramas_are_known_the_more_alike_they_have_to_be_and_a_goal_counts_places_unseen():
    seen, wanted = torch.randn(1, 5, 8, 32), torch.randn(1, 8, 32)
    few, many = (seen.repeat(1, times, 1, 1) for times in (20, 40))  # the views are whitened alike
    assert ((panorama_odds(few, wanted) - panorama_odds(many, wanted)[:, :100]) > 0.8).all()
    assert torch.allclose(panorama_odds(seen, wanted, few), panorama_odds(seen, wanted, many), atol=0.2)


class Whole(NCC):
    """Compares panoramas by the first features of each view."""

    def whole(self, described):
        return described[..., :16]


def test_visits_are_compared_in_worlds_as_cameras_compare_them():
    world = make_world([grid_scene(2, 2, headings=8, goals=(0,), feature_width=64)])
    around = world.panoramas()
    seen, visit = around[None, [0, 9, 17]], around[None, 12]
    for recogniser in (Whole(), NCC()):
        found = VisitScores(recogniser, world).of_visits(seen, visit)
        assert found.flatten().argmax() == 8 + 3
        assert torch.allclose(found, compare(recogniser, world.features[seen], world.features[visit]), atol=1e-5)
        fours = seen[..., ::2], visit[..., ::2]
        four = VisitScores(recogniser, world).of_visits(*fours)
        assert torch.allclose(four, compare(recogniser, *(world.features[ids] for ids in fours)), atol=1e-5)
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


NUMBER = st.floats(-5, 5, allow_nan=False, width=32)
VECTOR = st.lists(NUMBER, min_size=6, max_size=6).filter(lambda values: np.std(values) > 0.01)


@given(VECTOR, VECTOR)
def test_ncc_is_pearsons_coefficient(a, b):
    found = ncc(torch.tensor(a, dtype=torch.float64), torch.tensor(b, dtype=torch.float64))
    assert found.item() == pytest.approx(np.corrcoef(a, b)[0, 1], abs=1e-9)


def test_ncc_with_a_constant_vector_is_zero():
    # In float32 the mean of such a vector is not quite its value, and what remains is taken for a pattern.
    constant = torch.full((2048,), 0.1)
    assert ncc(constant, torch.randn(2048)) == 0
    assert ncc(constant, constant) == 0


@pytest.mark.parametrize("match", ["views", "front"])
def test_scores_are_the_coefficients_of_every_goal_with_every_state_and_above_a_threshold_it_stops(match):
    world = make_world([grid_scene(2, 1, name=name, goals=(goal,), seed=goal) for name, goal in (("a", 1), ("b", 6))])
    scores = TemplateStop(match=match).scores(world)
    assert scores.shape == (2 * 8,)
    views = world.features[world.surrounding[:, : 4 if match == "views" else 1]].flatten(1)
    for index, goal in enumerate(world.goals):
        expected = [np.corrcoef(views[goal], views[state])[0, 1] for state in range(8 * index, 8 * index + 8)]
        assert world.block(scores, index).tolist() == pytest.approx(expected, abs=1e-5)
    threshold = scores.sort().values[-5].item()  # above it are two states besides the goals
    assert torch.equal(TemplateStop(threshold, match)(world), scores > threshold)


def test_nobody_stops_in_another_scene_or_where_the_goal_is_out_of_reach():
    # Both scenes look the same everywhere, and so do the places that a wall cuts off.
    rooms = [grid_scene(3, 1, name=name, goals=(1,), blocked=[(1, 0)]) for name in ("a", "b")]
    world = make_world(rooms)
    world.features[:] = torch.rand(16)
    stops = torch.stack(world.pairs(), 1)[TemplateStop()(world)].tolist()
    assert stops == [[0, state] for state in range(4)] + [[1, 8 + state] for state in range(4)]


def test_a_stop_that_matches_something_else_is_refused():
    with pytest.raises(ValueError, match="match is 'views' or 'front', not 'sides'"):
        TemplateStop(match="sides")


@pytest.mark.parametrize(("looks", "compared"), [(0, 2 * 24), (1, 3)])
def test_whole_rows_are_computed_where_views_return_and_else_what_is_asked_for(looks, compared, monkeypatch):
    scores, counted = VisitScores(NCC(), make_world([grid_scene(looks=looks)])), []
    compute = NCC.scores
    monkeypatch.setattr(NCC, "scores", lambda *views: counted.append(compute(*views)) or counted[-1])
    for _ in range(2):
        scores(torch.tensor([3, 3, 9]), torch.tensor([4, 7, 20]))
        assert sum(answer.numel() for answer in counted) == compared
