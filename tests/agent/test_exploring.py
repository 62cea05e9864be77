"""A navigator that walks through a place once and then goes to any photo of it: by image graphs and maps of places."""

import numpy as np
import pytest
import torch
from elsewhere import DEVICE, device_elsewhere
from odds import Odds
from refusals import refused
from rooms import grid_scene
from shown_goals import images_of, look_up, rooms, trained, walk_through, walk_until_stop

from dirl import Navigator
from dirl.agent.mapping import ImageGraph, load_graph
from dirl.scenes import make_world


@pytest.fixture(scope="module")
def world():
    return rooms(width=48)


@pytest.fixture(scope="module")
def navigator(world, tmp_path_factory):
    """Of a policy that has learnt nothing."""
    folder = tmp_path_factory.mktemp("run")
    trained(folder, world)
    return Navigator.load(folder, look_up(world), extractor="random")


@pytest.fixture(scope="module")
def explorer(navigator, world):
    """After a walk in which the navigator chose where to go."""
    walk = navigator.explore(turns=4)
    assert walk.next_action() is None
    walk_through(walk, world)
    assert len(walk.graph) == len(world)
    return walk


def goes_straight(navigator, world, start, goal, around=None):
    """Whether a navigator that sees what surrounds it, or more, gets to its goal on a shortest way."""
    around = world.surrounding if around is None else around
    passed, _ = walk_until_stop(lambda at: navigator.act(images_of(around[at])), world, start, 30)
    return passed[-1] == goal and len(passed) - 1 == world.scenes[0].distances[start, goal]


def test_it_goes_to_any_photo_on_a_shortest_way(navigator, explorer, world):
    for goal, start, seen in ((1, 18, world.surrounding[1]), (13, 0, world.surrounding[13]), (22, 7, 22)):
        navigator.reset(images_of(seen), graph=explorer.graph, last_steps=0)
        assert goes_straight(navigator, world, start, goal)
        assert navigator.agent.guide.match == pytest.approx(1, abs=1e-4)


def test_the_last_steps_are_the_policys(navigator, explorer, world):
    seen = images_of(world.surrounding[22])
    navigator.reset(seen)
    own = [navigator.act(images_of(around)).action for around in world.surrounding]
    navigator.reset(seen, graph=explorer.graph, last_steps=2)
    far = world.scenes[0].distances[:, 22]
    for state, around in enumerate(world.surrounding):
        explorer.graph.lose()
        navigator.agent.guide.action = None
        led = navigator.act(images_of(around)).action
        assert led == own[state] if far[state] <= 2 else far[world.graph[state, led]] == far[state] - 1
    navigator.reset(seen)
    assert navigator.agent.guide is None


def test_an_image_graph_is_made_and_used_by_the_navigators_recogniser(world, navigator, tmp_path, monkeypatch):
    monkeypatch.setattr("dirl.agent.loading.build_recogniser", lambda *_: Odds())
    trained(tmp_path / "run", world)
    sure = Navigator.load(tmp_path / "run", look_up(world), extractor="random")
    walk = sure.explore(turns=4)
    assert (walk.graph.threshold, walk.graph.keep, walk.graph.margin) == (0.9, 0, 1)
    walk_through(walk, world)
    assert len(walk.graph) == len(world)
    folder, seen = walk.save(tmp_path / "map"), images_of(world.surrounding[13])
    sure.reset(seen, graph=folder, last_steps=0)
    assert goes_straight(sure, world, 18, 13)
    for graph in (folder, walk.graph):
        refused("was made with another recogniser: 'odds", navigator.reset, seen, graph=graph)


def test_turns_of_another_angle_than_the_maps_are_noticed_and_a_panorama_is_led_as_well(tmp_path):
    place = make_world([grid_scene(goals=(0,), feature_width=48, headings=8)])
    trained(tmp_path / "run", place, "episodic_memory=planning")
    navigator = Navigator.load(tmp_path / "run", look_up(place), extractor="random", turns=8)
    for given in (4, 12):
        told = f"^turns={given}: after . of . quarter turns the views are not those"
        refused(told, walk_through, navigator.explore(turns=given), place)
    walk = navigator.explore(turns=8)
    walk_through(walk, place)
    navigator.reset(images_of(place.surrounding[13]), graph=walk.graph, last_steps=0)
    assert goes_straight(navigator, place, 40, 13, place.panoramas())


def test_what_cannot_be_used_is_said(navigator, explorer, world, tmp_path):
    goal = images_of(world.surrounding[5])
    refused("the map is empty", navigator.reset, goal, graph=ImageGraph())
    refused("holds no map", navigator.reset, goal, graph=tmp_path)
    refused("a map leads one agent", navigator.reset, np.stack([goal, goal]), graph=explorer.graph)
    refused("action=7: expected 0 ahead", explorer.see, goal, 7)
    narrow = ImageGraph()
    narrow.see(torch.randn(4, 5))
    refused("the map has 5 features a view, the navigator 48", navigator.reset, goal, graph=narrow)


@pytest.fixture
def localiser(tmp_path, world, monkeypatch):
    """Of a policy that has learnt nothing, with a memory that localises: its maps are of places."""
    monkeypatch.setattr("dirl.agent.loading.build_recogniser", lambda *_: Odds())
    trained(tmp_path / "run", world, "episodic_memory=localising")
    return Navigator.load(tmp_path / "run", look_up(world), extractor="random")


def explored(localiser, world, known=None):
    explorer = localiser.explore(known, turns=4)
    walk_through(explorer, world)
    return explorer


def test_a_map_of_places_leads_straight_to_any_photo_if_the_memory_localises(localiser, world, tmp_path):
    explorer = explored(localiser, world)
    folder, walked_through = explorer.save(tmp_path / "map"), explorer.graph.map()
    known = load_graph(folder)
    assert len(known) == len(world)
    assert torch.equal(known.seen, walked_through.seen)
    for name in ("cost", "after", "node", "goal", "position", "heading", "action", "mapped"):
        assert torch.equal(getattr(known.places, name), getattr(walked_through.places, name))
    for goal, start, seen in ((1, 18, world.surrounding[1]), (13, 0, world.surrounding[13]), (13, 18, 13)):
        localiser.reset(images_of(seen), graph=folder)
        assert goes_straight(localiser, world, start, goal)
    assert len(explored(localiser, world, known).graph.map()) == len(known)
    localiser.memory = None
    for use in (lambda: localiser.explore(known), lambda: localiser.reset(images_of(1), graph=known)):
        refused(r"^graph: this map is for episodic_memory=localising; load ", use)


def test_a_map_of_places_that_was_saved_serves_on_another_device(localiser, world, tmp_path, monkeypatch):
    folder = explored(localiser, world).save(tmp_path / "map")

    def actions():
        localiser.reset(images_of(world.surrounding[13]), graph=folder)
        return [localiser.act(images_of(world.surrounding[state])).action for state in (0, 0, 18)]

    on_cpu, encoder = actions(), localiser.encoder
    localiser.encoder = lambda images: encoder(images.cpu())
    with device_elsewhere(monkeypatch):
        localiser.policy.to(DEVICE)
        localiser.recogniser.to(DEVICE)
        assert actions() == on_cpu


def test_a_map_of_panoramas_is_made_and_used_by_a_robot_that_turns_by_45_degrees(localiser, tmp_path, monkeypatch):
    monkeypatch.setattr("dirl.agent.navigator.GoalPoints", None)  # the map has none to compare
    localiser.points = True  # as where XFeat is installed
    place = make_world([grid_scene(headings=8, goals=(0, 13), feature_width=48)])
    localiser.encoder, localiser.turns = look_up(place), 8
    around, explorer = place.panoramas(), localiser.explore(turns=8)
    walk_through(explorer, place, around)
    folder, goal = explorer.save(tmp_path / "map"), images_of(place.surrounding[13])
    assert (load_graph(folder).turns, len(load_graph(folder))) == (8, 48)
    localiser.reset(goal, graph=folder)
    refused("^images: 4 views, and the map is of 8; give as many", localiser.act, images_of(place.surrounding[40]))
    assert goes_straight(localiser, place, 40, 13, around)
    localiser.turns = 4
    refused("^graph: was made with turns=8, this navigator has 4", localiser.reset, goal, graph=folder)
