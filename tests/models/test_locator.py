"""Where a network says that the goal lies."""

from types import SimpleNamespace

import pytest
import torch
from rooms import grid_scene

from dirl.agent.cameras import FeaturePolicy, Views
from dirl.agent.decisions import AgentBatch, WorldTables, locating
from dirl.envs import SurroundingViews
from dirl.evaluation.episodes import RandomPolicy
from dirl.models import FeatureTable, SiameseEncoder
from dirl.models import locator as module
from dirl.models.locator import FinePairs, GoalLocator
from dirl.perception.backbones.patches import FINE_SHAPE, PATCH_SHAPE, coarse
from dirl.scenes import make_world


def locator(features=8):
    torch.manual_seed(0)
    return GoalLocator(SiameseEncoder(features, 16), 16, 3).eval()


def views(count, of=4):
    return torch.randn(count, of, *FINE_SHAPE)


@pytest.mark.parametrize("shown", [1, 4])
def test_facing_another_view_is_to_see_the_views_turned(shown, monkeypatch):
    tells, seen, goal = locator(), torch.rand(5, 4, 8), torch.rand(5, 4, 8)
    patches, goal_patches = views(5), views(5, shown)
    located = tells(seen, goal, patches, goal_patches)
    assert located.shape == (5, 4, 7, 7)
    torch.testing.assert_close(located.flatten(2).logsumexp(2), torch.zeros(5, 4), atol=1e-5, rtol=0)
    turned = tells(seen.roll(-1, 1), goal, patches.roll(-1, 1), goal_patches)
    torch.testing.assert_close(turned, located.roll(-1, 1))
    assert not torch.allclose(tells(seen, goal), located)
    monkeypatch.setattr(module, "PAIRS_AT_ONCE", 2)  # many visits are compared some at a time
    torch.testing.assert_close(tells(seen, goal, patches, goal_patches), located)


def test_what_the_views_of_a_goal_tell_is_added_up_in_any_order():
    fine, seen, goal = FinePairs().eval(), views(3), views(3, 2)
    alone = [fine(seen, goal[:, view : view + 1]) for view in range(2)]
    torch.testing.assert_close(fine(seen, goal), alone[0] + alone[1])


def test_patches_are_compared_by_column_and_standardised():
    """Two views with columns in another order tell what the same columns told, and a shift of all values nothing."""
    fine, seen, goal = FinePairs().eval(), views(2), views(2, 1)
    fine.measure(torch.cat([seen.flatten(0, 1), goal.flatten(0, 1)]))
    told = fine(seen, goal)
    other = FinePairs().eval()
    other.load_state_dict(fine.state_dict())
    other.mean = fine.mean + 5
    torch.testing.assert_close(other(seen + 5, goal + 5), told, atol=1e-4, rtol=1e-4)
    assert not torch.allclose(fine(seen + 5, goal + 5), told, atol=1e-2)


@pytest.mark.parametrize(("photo", "fine"), [(True, True), (False, False)])
def test_cameras_and_worlds_are_told_the_same(photo, fine):
    features, patches = torch.rand(20, 6), torch.randn(20, *(FINE_SHAPE if fine else PATCH_SHAPE))
    table = FeatureTable(features, patches=coarse(patches))
    policy = SimpleNamespace(features=table, locator=locator(table.width), memory=None)
    policy.locator.train()  # as evaluations find it
    told = locating(policy, SimpleNamespace(patches=patches))
    seen, goal = torch.randint(20, (3, 4)), torch.randint(20, (3, 4))
    if photo:
        goal[:, 1:] = 20  # no view
    raw = [features, coarse(patches).flatten(1), *([patches.flatten(1)] if fine else [])]
    raw = torch.cat([torch.cat(raw, 1), torch.zeros(1, sum(part.shape[1] for part in raw))])
    told_cameras = FeaturePolicy(policy, None).locate(raw[seen], raw[goal])
    torch.testing.assert_close(told_cameras, told(seen, goal))


@pytest.mark.parametrize(("sweeps", "fine"), [(True, True), (False, True), (True, False)])
def test_a_sweep_is_told_where_it_was_but_not_where_its_goal_lies(sweeps, fine):
    world = make_world([grid_scene(3, 2, goals=[0, 7], patches="fine" if fine else False)])
    agent = SimpleNamespace(locator=locator(16), features=FeatureTable(world.features))
    locate = locating(RandomPolicy(agent) if sweeps else agent, world)
    known = WorldTables(world, SurroundingViews(world), None, lambda *_: None, locate=locate, sweeps=sweeps)
    goal, state = torch.zeros(2, dtype=torch.int64), torch.tensor([0, 5])
    now = AgentBatch(known, state, goal, goal, state, state, world.surrounding[state])
    assert (now.displacement() is None) == sweeps
    # Whether it is at its goal a sweep is told too, as by a recogniser; coarse patches do not tell it well.
    assert (now.place_odds() is None) != fine
    elsewhere = AgentBatch(known, state, goal, goal + 1, state, state, world.surrounding[state])
    if fine:
        torch.testing.assert_close(elsewhere.place_odds(), now.place_odds())  # of its own goal, not of one it is shown
    if not sweeps:
        assert not torch.equal(elsewhere.displacement(), now.displacement())
    assert now.displacement(now.inputs).shape == (2, 4, 7, 7)


def test_cameras_too_tell_by_fine_patches_whether_they_are_at_the_goal():
    goal = SimpleNamespace(policy=SimpleNamespace(table=SimpleNamespace(inputs=6)))
    now = Views(goal, torch.zeros(1, 4, 8), threshold=0.0)
    now._located = torch.full((1, 4, 3, 3), 1 / 9).log()
    assert now.place_odds() is not None
