"""Maps of places that never look the same twice: made by a walk, used by later episodes."""

from dataclasses import replace
from itertools import pairwise

import pytest
import torch
from odds import Odds
from policies import indifferent
from rooms import grid_scene

from dirl.agent.mapping.graph_policy import explore
from dirl.agent.mapping.places import ParticleMapper, resampled, without_doubles
from dirl.envs import SurroundingViews
from dirl.evaluation.episodes import every_start
from dirl.evaluation.map_accuracy import map_quality, map_scene
from dirl.evaluation.protocol import EvaluationProtocol, metrics
from dirl.models import LocalisingMemory
from dirl.perception.recognition.recogniser import TemplateStop, VisitScores
from dirl.scenes import make_world
from dirl.scenes.graph import AHEAD, BACK

SIZE = {"feature_width": 64, "patches": True, "looks": 3}


@pytest.fixture(scope="module")
def world():
    first = grid_scene(4, 3, name="a", goals=(5, 30), noise=0.1, **SIZE)
    return make_world([first, grid_scene(3, 3, name="b", goals=(7,), seed=1, noise=0.1, **SIZE)])


@pytest.fixture(scope="module")
def walks(world):
    return [map_scene(world, index, LocalisingMemory(), VisitScores(Odds(), world), 3) for index in range(2)]


def test_a_walk_through_changing_rooms_makes_a_right_map_and_ends_by_itself(world, walks):
    for index, (known, passed) in enumerate(walks):
        assert map_quality(known, passed, world, index) == (1, 1, 0)
        assert len(known) == len(world.scenes[index])
        assert len(passed) < 3 * len(world.scenes[index])


def protocol_of(world, scores, recogniser=None, *, goal_view="surrounding", **conditions):
    """Episodes from every start, of an agent that localises and stops by log odds."""
    match = "front" if goal_view == "front" else "views"
    stop = TemplateStop(0.0, match, recogniser or Odds()).compared(world)
    conditions = {"memory": LocalisingMemory(), "scores": scores, **conditions}
    return EvaluationProtocol(world, SurroundingViews(world, goal_view), every_start(world), stop, 60, **conditions)


@pytest.mark.parametrize("panorama", [False, True])
def test_turns_may_be_small_and_panoramas_seen_at_once(panorama):
    world = make_world([grid_scene(3, 2, headings=8, goals=(5, 24), noise=0.1, **SIZE)])
    memory, scores = LocalisingMemory(), VisitScores(Odds(), world)
    known, passed = map_scene(world, 0, memory, scores, 4, panorama=panorama)
    assert map_quality(known, passed, world, 0) == (1, 1, 0)
    assert known.places.goal.shape[2] == (8 if panorama else 4)
    protocol = protocol_of(world, scores, goal_view="surrounding" if panorama else "front", panorama=panorama)
    alone = metrics(protocol.run(indifferent()))
    found = metrics(replace(protocol, maps=[known]).run(indifferent()))
    assert alone["sr"] == found["sr"] == 1
    assert found["spl"] > (0.98 if panorama else 0.9) > alone["spl"]
    assert known.places.node.shape == (1, len(passed))  # episodes leave the map as it is


class WholeOdds(Odds):
    """Compares panoramas by all their views."""

    def whole(self, described):
        return described


class Told(LocalisingMemory):
    """Notes which arrows it was told."""

    def arrive(self, places, alike, goal, costs, arrows=None, stayed=None):
        self.arrows = arrows
        return super().arrive(places, alike, goal, costs, arrows)


def test_a_walk_through_a_tour_tests_what_it_guesses_and_its_map_leads_to_goals_by_whole_panoramas():
    scene = grid_scene(3, 2, headings=8, goals=(5, 24), noise=0.3, **SIZE)
    graph = scene.graph.copy()
    state = int(((graph[:, BACK] >= 0) & (graph[:, AHEAD] >= 0)).argmax())
    other = next(c for c in range(state % 8, len(graph), 8) if c not in (state, *graph[state]))
    graph[state, BACK] = other  # a passage of one way: back leads elsewhere
    opposite = state // 8 * 8 + (state + 4) % 8
    graph[opposite, AHEAD] = other // 8 * 8 + (other + 4) % 8
    world = make_world([replace(scene, graph=graph)])
    memory, scores = LocalisingMemory(), VisitScores(WholeOdds(), world)
    known, passed = map_scene(world, 0, memory, scores, 6, panorama=True)
    assert map_quality(known, passed, world, 0) == (1, 1, 0)
    assert all(here != there for here, there in pairwise(passed))  # arrows tell which moves are blocked
    protocol = protocol_of(world, scores, WholeOdds(), memory=Told(), panorama=True, maps=[known], arrows=True)
    assert metrics(protocol.run(indifferent()))["sr"] == 1
    assert protocol.memory.arrows.shape[1:] == (8, 4)


def test_many_particles_make_a_better_map_than_one_where_single_looks_err():
    world = make_world([grid_scene(4, 3, noise=0.14, **SIZE)])
    scores = VisitScores(Odds(20.0), world)

    def wrong(particles, seed):
        looks = torch.Generator().manual_seed(seed)
        mapper = ParticleMapper(LocalisingMemory(), scores.of_visits, particles, seed)

        def seen(state):
            return world.surrounding[state] + torch.randint(world.looks, (), generator=looks) * len(world)

        passed = explore(mapper, world.scenes[0].graph, 3, 2 * len(world), seen)
        return map_quality(mapper.map(), passed, world, 0).wrong

    assert wrong(64, 0) + wrong(64, 1) < (wrong(1, 0) + wrong(1, 1)) / 4


def test_the_map_is_not_of_a_particle_that_has_just_sampled_what_is_improbable():
    for seed in range(20):
        options = {"seed": seed, "arrows": lambda visit: torch.ones((*visit.shape, 4), dtype=torch.bool)}
        mapper = ParticleMapper(LocalisingMemory(), lambda seen, _: torch.full(seen.shape[:3], -1.0), 64, **options)
        for action in (None, AHEAD):
            mapper.see(torch.arange(4), action)
        assert len(mapper.map()) == 4 * 2


def test_places_that_later_visits_take_for_one_become_one():
    first = replace(
        LocalisingMemory().begin(1, turns=8),
        cost=torch.full((1, 24, 4), 1.0),
        after=torch.full((1, 24, 4), -1),
        taken=torch.zeros((1, 24, 4), dtype=torch.bool),
        node=torch.tensor([[0, 8, 18, 0]]),  # the third visit looks where the first place has its second heading
        position=torch.zeros((1, 3, 2), dtype=torch.int64),
        heading=torch.zeros((1, 3), dtype=torch.int64),
    )
    first.after[0, 8, AHEAD], first.taken[0, 8, AHEAD] = 18, True
    odds = [torch.full((visit, 8), -9.0) for visit in range(4)]
    odds[2][0, 1] = odds[3][2, 7] = 9.0
    known = without_doubles(first, odds)
    assert known.node.tolist() == [[0, 8, 1, 0]]
    assert (known.after[0, 8, AHEAD].item(), known.position.shape[1]) == (1, 2)
    for change in ("moves", "arrows", "connected"):
        apart = replace(first, cost=first.cost.clone(), after=first.after.clone(), taken=first.taken.clone())
        if change == "moves":  # the same move leads to other places
            apart.after[0, [1, 18], AHEAD] = torch.tensor([8, 19])
            apart.taken[0, [1, 18], AHEAD] = True
        elif change == "arrows":
            apart.cost[0, 1, AHEAD] = torch.inf
        else:
            apart.after[0, 0, AHEAD], apart.taken[0, 0, AHEAD] = 16, True
        assert without_doubles(apart, odds).position.shape[1] == 3


def test_who_is_carried_elsewhere_finds_the_place_on_the_map_again(world, walks):
    known, passed = walks[0]
    mapper = ParticleMapper(LocalisingMemory(), VisitScores(Odds(), world).of_visits, known=known)
    for visit in (10, 3):
        assert mapper.see(world.surrounding[passed[visit]] + len(world)) == int(known.places.node[0, visit])
    assert mapper.frontier_action() is None  # nothing is left to be learnt
    assert known.begin(known.places.goal).mapped.all()
    assert len(mapper.map()) == len(known)


def test_particles_are_drawn_by_their_probabilities():
    drawn = resampled(torch.tensor([0.5, 0.0, 0.25, 0.25]), torch.Generator().manual_seed(0))
    assert drawn.tolist() == [0, 0, 2, 3]
