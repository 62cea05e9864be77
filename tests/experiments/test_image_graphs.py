"""What the reports on topological maps measure, in small rooms."""

import csv
from argparse import Namespace

import numpy as np
import torch
from rooms import grid_scene

from dirl.agent.mapping.walks import looks
from dirl.experiments.image_graph import by_graph, drawn_goals, measure
from dirl.experiments.wrong_merges import VARIANTS, Place, Traced, mapped, measured, twin_looks, wrong_links


def hall(**options):
    return grid_scene(5, 3, feature_width=64, **options)


def place_of(scene, look):
    clean = torch.tensor(scene.features)
    return Place(scene, clean, [(30, 7), (45, 0), (13, 59)], look or looks(scene, clean))


def test_maps_are_measured_beside_a_list(tmp_path):
    world = drawn_goals([hall(name="a"), hall(name="b", headings=8, seed=1)], 3)
    text = measure(world, {}, "2 rooms", Namespace(run=None, starts=3, out=tmp_path))
    with (tmp_path / "image_graph.csv").open() as file:
        rows = list(csv.DictReader(file))
    rates = {way: [float(row["SR"]) for row in rows if row["led by"] == way] for way in {row["led by"] for row in rows}}
    assert rates[by_graph(2.0)] == [1, 1]
    assert max(rates["list, walk of 2 N steps"]) < 1
    assert text.startswith("# Walk once, then go to any photo\n\n2 rooms, 180 states")
    assert (tmp_path / "image_graph.png").exists()


def test_twins_cost_less_where_matches_are_verified():
    scene = hall()
    place = place_of(scene, twin_looks(scene, torch.tensor(scene.features), 0.2, {30, 45, 13}))
    found = {verify: measured(place, 0.9, verify=verify) for _, verify in VARIANTS}
    assert found[False]["wrong links"] > found[True]["wrong links"]
    assert found[False]["nodes a state"] < found[True]["nodes a state"]
    assert found[True]["SR"] == 1
    assert measured(place_of(scene, None), 0.9, verify=True) == {
        **{"SR": 1, "SPL": 1, "located": 1},
        **{"wrong links": 0, "nodes a state": 1},
    }


def test_twins_show_what_another_place_shows_and_goals_have_none():
    scene = hall()
    clean, kept = torch.tensor(scene.features), {0, 5, 10}
    look = twin_looks(scene, clean, 0.4, kept)
    changed = {state for state in range(60) if not look(state).equal(looks(scene, clean)(state))}
    assert len(changed) == 4 * round(0.4 * 15)
    assert not changed & set(range(12))


def test_what_nodes_truly_are_is_kept_through_merges():
    scene = hall()
    graph = Traced(0.9, verify=True)
    graph.state = 7
    truth = mapped(place_of(scene, None), graph)
    assert sorted(truth.tolist()) == list(range(60))
    assert wrong_links(scene, graph, truth) == 0
    graph.moves[0][0] = 5
    assert np.isclose(wrong_links(scene, graph, truth), 1 / sum(end >= 0 for moves in graph.moves for end in moves))
