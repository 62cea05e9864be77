"""Image graphs: what was seen is merged where it looks the same, and leads to wherever the walk has been."""

import pytest
import torch
from refusals import refused
from rooms import grid_scene

from dirl.agent.mapping import ImageGraph
from dirl.agent.mapping.panoramas import UNKNOWN
from dirl.agent.mapping.walks import explore, step
from dirl.scenes.graph import AHEAD, BACK, LEFT, RIGHT

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
    explore(scene, graph, 5, 2 * len(scene))
    assert graph.frontier_action() is None  # nothing is left to be learnt
    assert len(graph) == len(scene)
    seen = looks(scene)
    node_of = [graph.locate(views) for views in seen]
    graph.lose()
    assert sorted(node_of) == list(range(len(scene)))
    for state, node in enumerate(node_of):
        found = [graph.moves[node][action] for action in range(4)]
        assert found == [node_of[step(scene.graph, state, action)] for action in range(4)]
    distances = graph.plan([node_of[7]])[:, 0]
    assert distances[node_of].tolist() == scene.distances[:, 7].tolist()


def test_a_move_is_known_in_all_four_forms():
    scene = grid_scene(3, 1, feature_width=64)
    seen = looks(scene)
    graph = ImageGraph()
    assert graph.see(seen[5]) == 0  # in the middle, facing the third place
    assert graph.see(seen[9], AHEAD) == 4
    assert (graph.moves[0][AHEAD], graph.moves[4][BACK]) == (4, 0)
    assert (graph.moves[2][BACK], graph.moves[6][AHEAD]) == (6, 2)
    assert graph.moves[0][BACK] == graph.moves[2][AHEAD] == UNKNOWN
    assert graph.see(seen[9], AHEAD) == 4  # a wall
    assert graph.moves[4][AHEAD] == graph.moves[6][BACK] == 4 or (graph.moves[4][AHEAD], graph.moves[6][BACK]) == (4, 6)
    assert [graph.moves[4][RIGHT], graph.moves[4][LEFT]] == [5, 7]


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
    explore(scene, graph, 9, 4 * len(scene), lambda state: features[torch.tensor(scene.surrounding)[state]])
    graph.lose()
    assert len(graph) == len(scene)


def test_a_walk_that_ends_in_doubt_believes_the_match():
    graph, views = ImageGraph(), torch.randn(3, 4, 64, generator=torch.Generator().manual_seed(0))
    graph.see(views[0])
    graph.see(views[1], AHEAD)
    graph.see(views[2], AHEAD)
    graph.see(views[0], AHEAD)
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
    explore(scene, graph, 5, 100)
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
    explore(scene, graph, 1, 100)
    graph.lose()
    node_of = [graph.locate(views) for views in seen]
    for believed in (node_of[5], node_of[end]):
        graph.follow(seen[1])
        graph.follow(seen[end], AHEAD)
        assert graph.moves[node_of[1]][AHEAD] == believed
        graph.lose()


@pytest.mark.parametrize("options", [{"threshold": 2.0}, {"turns": 6}])
def test_options_are_checked(options):
    refused(f"{next(iter(options))}=", ImageGraph, **options)
