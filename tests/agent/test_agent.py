import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from policies import indifferent
from rooms import grid_scene

from dirl.agent.agent import Localising, Planning, Remembering, arrow_costs, likeness
from dirl.agent.cameras import compare
from dirl.envs import SurroundingViews
from dirl.evaluation.episodes import EvaluationProtocol, RandomPolicy, every_start
from dirl.evaluation.protocol import metrics
from dirl.models import LocalisingMemory, PlanningMemory
from dirl.perception.recognition.recogniser import NCC
from dirl.scenes import make_world


class Seen:
    """A visit whose policy answers always the same."""

    arrows = None

    def __init__(self, visit):
        self.visit = visit

    def alike(self, seen):
        return compare(NCC(), seen, self.visit)

    def facing(self, chosen):
        return torch.arange(16.0).view(1, 4, 4)

    def goal_around(self, chosen):
        return torch.zeros(1, 4, dtype=torch.bool)


def test_what_looks_like_a_later_look_of_a_place_but_not_like_the_first_is_another_place():
    """Looks 12 degrees apart match above 0.95, those 24 degrees apart do not; places are known by their first look."""
    first, other = torch.linalg.qr(torch.randn(4 * 64, 2, generator=torch.Generator().manual_seed(0)))[0].T
    agent = Planning(PlanningMemory(), torch.tensor([4]))
    for angle, node in ((0, 0), (12, 0), (24, 8)):
        look = math.cos(math.radians(angle)) * first + math.sin(math.radians(angle)) * other
        action, planned = agent.act(Seen(look.view(1, 4, 64)))
        assert agent.past.here.tolist() == [node]
        assert planned.isfinite().all()
        agent.action = torch.zeros_like(action)


@pytest.mark.parametrize(("action", "photo"), [(1, True), (2, False)])
@pytest.mark.parametrize(("a_turn_later", "places", "goal"), [(45.0, 3, -5.0), (11.0, 2, -0.22)])
def test_what_looks_the_same_after_turns_has_to_look_as_much_the_same_later(action, photo, a_turn_later, places, goal):
    """The second move leads to what looks 8 nats like the first place: another one where views hardly change."""
    agent, faced = Localising(LocalisingMemory(), turns=8), []

    def see(heading, nats):
        ahead = torch.tensor([(heading - earlier) % 8 for earlier in faced], dtype=torch.int64)
        agent.arrive(
            SimpleNamespace(
                visit=torch.zeros(1, 8, 1),
                alike=lambda seen: torch.full((1, len(faced), 8), -9.0).scatter(2, ahead[None, :, None], nats),
                goal_odds=lambda visits, _: torch.zeros(1, visits.shape[1], 8),
                confirmed=lambda odds: odds + 2,
                place_odds=lambda: None,
                displacement=lambda *_: None,
                inputs=None,
                points=None,
                photo=photo,
                pooled=torch.ones(1, 8, 4),
                goal_pooled=torch.ones(1, 1, 4),
                along=None,
                toward=None,
                arrows=torch.ones(1, 8, 4, dtype=torch.bool),
            )
        )
        faced.append(heading)

    see(0, 0.0)
    for turn in range(1, 4):
        agent.action = torch.tensor([action])
        see(turn if action == 1 else -turn, a_turn_later)
    agent.action = torch.tensor([0])
    see(faced[-1], -9.0)
    see(faced[-1], 8.0)
    assert agent.past.used.view(-1, 8).any(1).sum() == places
    assert torch.allclose(agent.past.goal[0, -1], torch.tensor(2.0 if photo else goal + 2), atol=0.01)


def test_a_policy_is_trusted_half_where_a_memory_plans():
    """An action that it prefers by one nat costs half a nat less."""
    costs = Planning(PlanningMemory(), torch.tensor([4])).costs(Seen(None))(torch.tensor([True]))
    assert torch.allclose(costs[..., :-1] - costs[..., 1:], torch.tensor(0.5), atol=1e-5)


def test_likeness_is_of_what_differs_within_the_place():
    """Views of one place share most of their features; centred, only the view that shows the goal is like it."""
    generator = torch.Generator().manual_seed(0)
    place = 5 * torch.randn(64, generator=generator)
    views = place + torch.randn(1, 8, 64, generator=generator)
    goal = (views[:, 2] + 0.1 * torch.randn(1, 64, generator=generator)).unsqueeze(1)
    found = likeness(views, goal, views.mean(1))[0]
    assert found[[1, 2, 3]].min() > 0.9  # the view itself, and the two beside it, which overlap it
    assert found[[0, 4, 5, 6, 7]].max() < 0.5
    assert not likeness(views, goal[:, :0], views.mean(1)).any()
    along = views.roll(1, 1)  # each arrow lies one view to the left of the heading that shows it
    exact = likeness(views, goal, views.mean(1), along)[0]
    assert exact.argmax() == 3
    assert exact[[1, 2]].max() < 0.8


def test_a_move_along_an_arrow_costs_less_where_the_goal_is_likely_forwards_and_backwards():
    arrows = torch.zeros(1, 4, 4, dtype=torch.bool)
    arrows[..., 1:3] = True  # turns
    arrows[0, 1, 0] = arrows[0, 3, 3] = arrows[0, 0, 0] = True  # a link to the right, and one ahead
    cost = arrow_costs(torch.tensor([[0.1, 0.9, 0.0, 0.0]]), arrows)[0]
    assert cost[1, 0] == cost[3, 3] < cost[0, 0]
    assert (cost[:, 1:3] == 1).all()
    assert cost[2, [0, 3]].isinf().all()
    points = arrow_costs(torch.ones(1, 4), arrows, torch.tensor([[0.0, 1, 0, 0]]))[0]
    assert points[1, 0] == points[3, 3] < points[0, 0] - 4, "what points tell counts beside likeness"


def test_a_place_counts_once_however_long_the_agent_stays_there():
    """Beside another agent, that is always at new places."""
    generator = torch.Generator().manual_seed(0)
    shown = torch.ones(2, 4, 4, dtype=torch.bool)
    first, second = (
        SimpleNamespace(pooled=torch.randn(2, 4, 8, generator=generator), arrows=shown, along=None, toward=None)
        for _ in range(2)
    )
    for place in (first, second):
        place.goal_pooled = torch.ones(2, 1, 8)
    costs = []
    for stays in (1, 5):
        agent = Remembering(PlanningMemory())
        for stay in range(stays):
            agent.costs(first)(torch.tensor([stay == 0, True]))
        costs.append(agent.costs(second)(torch.tensor([True, True]))[0])
    assert torch.equal(*costs)


def test_in_a_world_each_arrow_is_judged_by_the_view_along_it():
    """Along the arrows that lead nearer the goal is seen; seen along those of other states it leads astray."""
    scene, goal = grid_scene(5, 5, feature_width=32), 0
    along = np.where(nearer(scene, goal)[:, None], scene.features[goal], -scene.features[goal]).astype(np.float16)
    spl = [searched(replace(scene, along=views), goal) for views in (along, along[::-1])]
    assert spl[0] > 1.2 * spl[1]


def test_in_a_world_the_arrow_that_clearly_leads_to_the_goal_is_followed():
    """By the table of its four views, or of the photo that is given; the sweep, which ignores goals, reads neither."""
    scene, goals = grid_scene(5, 5, feature_width=32), (0, 42)
    toward = np.zeros((2, len(scene), len(scene)), np.float16)
    for goal in goals:
        toward[0, :, goal] = nearer(scene, goal)
    known, other = (replace(scene, toward=table) for table in (toward, toward[::-1]))
    assert searched(known, *goals) > 1.2 * searched(other, *goals)
    assert searched(other, *goals, goal_view="front") > 1.2 * searched(known, *goals, goal_view="front")
    assert searched(known, *goals, sweeps=True) == searched(scene, *goals, sweeps=True)


def nearer(scene, goal):
    """Of the moves ahead those which lead nearer."""
    ahead = scene.graph[:, 0]
    return (ahead >= 0) & (scene.distances[ahead, goal] < scene.distances[:, goal])


def searched(scene, *goals, goal_view="surrounding", sweeps=False):
    """The SPL of agents that see arrows, with a policy that knows nothing."""
    world = make_world([scene], {scene.name: goals})
    protocol = EvaluationProtocol(
        world=world,
        observation=SurroundingViews(world, goal_view),
        starts=every_start(world),
        memory=PlanningMemory(),
        panorama=True,
        arrows=True,
    )
    return metrics(protocol.run(RandomPolicy() if sweeps else indifferent()))["spl"]
