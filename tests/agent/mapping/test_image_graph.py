"""Image graphs: what was seen is merged where it looks the same; their files; and navigation by one as a policy."""

import pytest
import torch
from policies import always, run_episodes
from refusals import refused
from rooms import grid_scene

from dirl.agent.mapping import GraphMemory, GuidedPolicy, ImageGraph, load_graph, save_graph
from dirl.agent.mapping.graph_policy import explore
from dirl.envs import SurroundingViews
from dirl.evaluation.episodes import every_start
from dirl.evaluation.protocol import metrics
from dirl.runs.checkpoints import save_checkpoint
from dirl.scenes import make_world
from dirl.scenes.graph import AHEAD, RIGHT

ROOM = {"width": 4, "depth": 3, "blocked": [(1, 1)], "feature_width": 64}


def looks(scene):
    """What is seen from each state, float32 ``[N, 4, D]``."""
    return torch.tensor(scene.features)[torch.tensor(scene.surrounding)]


def disturbed(views, share, seed):
    """The same with noise, a share of the features' deviation."""
    return views + share * views.std() * torch.randn(views.shape, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("headings", [4, 12])
def test_a_walk_through_everything_gives_the_scene(headings):
    scene = grid_scene(**ROOM, headings=headings)
    graph = ImageGraph(turns=headings)
    explore(graph, scene.graph, 5, 2 * len(scene), looks(scene).__getitem__)
    assert graph.frontier_action() is None  # nothing is left to be learnt
    assert len(graph) == len(scene)
    seen = looks(scene)
    node_of = [graph.locate(views) for views in seen]
    graph.lose()
    assert sorted(node_of) == list(range(len(scene)))
    for state, node in enumerate(node_of):
        found = [graph.moves[node][action] for action in range(4)]
        assert found == [node_of[state if after < 0 else after] for after in scene.graph[state]]
    distances = graph.plan([node_of[7]])[:, 0]
    assert distances[node_of].tolist() == scene.distances[:, 7].tolist()


def test_what_stands_still_does_not_flicker():
    """Two places that look much alike, and noise: which node fits best changes from look to look."""
    views = torch.randn(4, 64, generator=torch.Generator().manual_seed(0))
    near = disturbed(views, 0.1, 1)
    graph = ImageGraph(threshold=0.998)
    graph.see(views)
    graph.see(near, AHEAD)
    noisy = [disturbed(near, 0.7, seed) for seed in range(2, 42)]
    best = {int(graph.scores(look).argmax()) for look in noisy}
    assert len(best) > 1
    assert {graph.locate(look) for look in noisy} == {4}
    graph.lose()
    assert {graph.locate(look) for look in noisy} == {None}
    graph.follow(near)
    assert graph.at == 4
    graph.follow(views)
    assert graph.at == 4  # one of them is as good as the other, and it stays


@pytest.mark.parametrize("turns", [4, 8])
def test_twins_are_told_apart_by_their_neighbours(turns):
    scene = grid_scene(5, 3, feature_width=64, headings=turns)
    features = torch.tensor(scene.features)
    features[-turns:] = features[:turns]
    graph = ImageGraph(turns=turns)
    explore(graph, scene.graph, 9, 4 * len(scene), lambda state: features[torch.tensor(scene.surrounding)[state]])
    graph.lose()
    assert len(graph) == len(scene)


def test_a_walk_that_ends_in_doubt_believes_the_match():
    graph, views = ImageGraph(), torch.randn(3, 4, 64, generator=torch.Generator().manual_seed(0))
    for place, action in ((0, None), (1, AHEAD), (2, AHEAD), (0, AHEAD)):
        graph.see(views[place], action)
    assert len(graph) == 16
    assert graph.doubt is not None
    graph.lose()
    assert len(graph) == 12
    assert graph.moves[8][AHEAD] == 0


def test_a_node_that_is_known_to_be_turned_to_from_another_one_is_no_twin():
    graph, views = ImageGraph(turns=8), torch.randn(3, 4, 64, generator=torch.Generator().manual_seed(0))
    graph.see(views[0])
    aside = graph.see(views[1], RIGHT)
    graph.lose()
    graph.see(views[2])
    graph.see(views[1], RIGHT)  # looks like `aside`, which lies to the right of the first place
    assert (graph.doubt, len(graph)) == (None, 16)
    assert graph.moves[0][RIGHT] == aside
    graph.lose()
    assert len(graph) == 16


def test_one_look_that_fits_nowhere_is_passed_over():
    scene = grid_scene(**ROOM)
    graph, seen = ImageGraph(), looks(scene)
    explore(graph, scene.graph, 5, 100, seen.__getitem__)
    size = len(graph)
    graph.lose()
    first = graph.see(seen[5])
    assert graph.see(torch.randn(4, 64), RIGHT) == graph.moves[first][RIGHT]
    assert len(graph) == size
    graph.see(torch.randn(4, 64), RIGHT)
    assert len(graph) == size + 4  # the second is of a new place


@pytest.mark.parametrize("end", [9, 1], ids=["it slides through a place", "a door has been closed"])
def test_what_was_seen_is_only_changed_by_what_is_seen_twice(end):
    scene = grid_scene(3, 1, feature_width=64)
    graph, seen = ImageGraph(), looks(scene)
    explore(graph, scene.graph, 1, 100, seen.__getitem__)
    graph.lose()
    node_of = [graph.locate(views) for views in seen]
    for believed in (node_of[5], node_of[end]):
        graph.follow(seen[1])
        graph.follow(seen[end], AHEAD)
        assert graph.moves[node_of[1]][AHEAD] == believed
        graph.lose()


def test_a_map_comes_back_as_it_was_and_other_files_are_refused(tmp_path):
    graph, scene = ImageGraph(0.85), grid_scene()
    explore(graph, scene.graph, 0, 12, looks(scene).__getitem__)
    folder = save_graph(graph, tmp_path / "map", extractor="random")
    again = load_graph(folder, extractor="random")
    assert (again.moves, again.observed, again.at) == (graph.moves, graph.observed, None)
    assert (again.threshold, again.turns) == (0.85, 4)
    assert (again.views == graph.views).all()
    look = graph.views[1].roll(-1, 0)
    assert again.locate(look) == graph.locate(look) == 5
    refused("was made with another extractor: 'random', not 'resnet'", load_graph, folder, extractor="resnet")
    refused("^threshold=2: expected a correlation", ImageGraph, threshold=2.0)
    (file,) = folder.iterdir()
    file.write_bytes(file.read_bytes().replace(b"random", b"resnet"))
    refused("is damaged", load_graph, folder)
    save_checkpoint(file, {"turns": 4})
    refused("is no map of dirl", load_graph, folder)
    file.unlink()
    refused("holds no map", load_graph, folder)


@pytest.fixture(scope="module")
def world():
    rooms = [
        grid_scene(4, 3, name="a", blocked=[(1, 1)], feature_width=64, goals=(0, 21, 42), seed=0),
        grid_scene(3, 3, name="b", headings=8, feature_width=64, goals=(5, 50), seed=1),
    ]
    return make_world(rooms)


def walked(policy, world, view="surrounding", **options):
    observation = SurroundingViews(world, view)
    return run_episodes(policy, world, every_start(world), observation=observation, max_steps=60, **options)


@pytest.mark.parametrize(("view", "greedy"), [("surrounding", True), ("front", True), ("surrounding", False)])
def test_after_one_walk_it_goes_anywhere_also_by_drawn_actions(world, view, greedy):
    found = metrics(walked(GraphMemory(world), world, view, greedy=greedy))
    assert found["sr"] == 1
    assert found["spl"] > 0.98


def test_it_goes_to_what_it_is_shown_and_knows_less_of_a_short_walk(world):
    other = torch.tensor([1, 2, 0, 4, 3])
    assert metrics(walked(GraphMemory(world), world, shown=other))["sr"] < 0.6  # its own goal is missed
    assert metrics(walked(GraphMemory(world, steps_per_state=0.2), world))["spl"] < 0.78


def test_the_last_steps_are_the_policys(world):
    memory = GraphMemory(world)
    led = walked(GuidedPolicy(always(RIGHT), memory, last_steps=0), world)
    assert metrics(led)["sr"] == 1
    near = walked(GuidedPolicy(always(RIGHT), memory, last_steps=2), world)
    alone = walked(always(RIGHT), world)
    assert metrics(alone)["sr"] < metrics(near)["sr"] < 1
