"""What the report on topological maps measures, in small rooms."""

import csv

from rooms import grid_scene

from dirl.experiments.image_graph import by_graph, drawn_goals, measure


def hall(**options):
    return grid_scene(5, 3, feature_width=64, **options)


def test_maps_are_measured_beside_a_list(tmp_path):
    world = drawn_goals([hall(name="a"), hall(name="b", headings=8, seed=1)], 3)
    text = measure(world, {}, "2 rooms", tmp_path, starts=3)
    with (tmp_path / "image_graph.csv").open() as file:
        rows = list(csv.DictReader(file))
    rates = {way: [float(row["SR"]) for row in rows if row["led by"] == way] for way in {row["led by"] for row in rows}}
    assert rates[by_graph(2.0)] == [1, 1]
    assert max(rates["list, walk of 2 N steps"]) < 1
    assert text.startswith("# Walk once, then go to any photo\n\n2 rooms, 180 states")
    assert (tmp_path / "image_graph.png").exists()
