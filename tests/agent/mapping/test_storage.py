"""Image graphs as files."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from refusals import refused
from rooms import grid_scene
from spoil import spoilt

from dirl.agent.mapping import ImageGraph, MapError, load_graph, save_graph
from dirl.agent.mapping.walks import explore
from dirl.runs.checkpoints import save_checkpoint


@pytest.fixture
def saved(tmp_path):
    graph = ImageGraph(0.85)
    explore(grid_scene(), graph, 0, 12)
    return graph, save_graph(graph, tmp_path / "map", extractor="random")


def test_a_map_comes_back_as_it_was(saved):
    graph, folder = saved
    again = load_graph(folder, extractor="random")
    assert (again.moves, again.observed, again.at) == (graph.moves, graph.observed, None)
    assert (again.threshold, again.turns) == (0.85, 4)
    assert (again.views == graph.views).all()
    look = graph.views[1].roll(-1, 0)
    assert again.locate(look) == graph.locate(look) == 5
    assert sorted(path.name for path in folder.iterdir()) == ["map.pt"]


def test_a_map_of_another_extractor_a_file_of_something_else_and_none_are_refused(saved):
    refused("was made with another extractor: 'random', not 'resnet'", load_graph, saved[1], extractor="resnet")
    file = saved[1] / "map.pt"
    save_checkpoint(file, {"turns": 4})
    refused("is no map of dirl", load_graph, saved[1])
    file.unlink()
    refused("holds no map", load_graph, saved[1])


@given(drawn=st.data())
@settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_what_is_damaged_is_refused_or_read_as_it_was(saved, drawn):
    graph, folder = saved
    file = folder / "map.pt"
    whole = file.read_bytes()
    file.write_bytes(drawn.draw(spoilt(whole)))
    try:
        again = load_graph(folder)
        assert (again.moves, again.observed, again.threshold) == (graph.moves, graph.observed, graph.threshold)
        assert (again.views == graph.views).all()
    except MapError:
        refused(".", load_graph, folder)
    finally:
        file.write_bytes(whole)
