"""Properties of `read_dump`, whatever a file holds: a scene that can be walked in, or one `SceneError`."""

import tempfile
from pathlib import Path

import h5py
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from malformed import instead, refused
from rooms import grid_scene, published_dump, read_here

from dirl.scenes import SceneError

GOOD = grid_scene()


def reads(spoil):
    """The scene of a good file that has been spoiled; None if it was refused, by a proper error."""
    with tempfile.TemporaryDirectory() as folder:
        path = published_dump(Path(folder) / "room.h5", GOOD, crops=1)
        with h5py.File(path, "a") as file:
            spoil(file)
        return read_or_refused(path)


def read_or_refused(path):
    try:
        scene = read_here(path)
    except SceneError:
        scene = None
    if scene is None:
        refused(path)
    else:
        check_walkable(scene)
    return scene


def check_walkable(scene):
    states = np.arange(len(scene))
    assert ((scene.graph >= -1) & (scene.graph < len(scene))).all()
    alive = (scene.graph >= 0).any(1)
    right = scene.graph[alive, 1]
    assert (scene.graph[right, 2] == states[alive]).all()
    around = scene.surrounding
    assert (np.sort(around[alive], 1)[:, 1:] != np.sort(around[alive], 1)[:, :-1]).all()  # four different ones
    assert np.abs(scene.positions[around] - scene.positions[:, None]).max() < 0.01
    for values in (scene.positions, scene.headings, scene.features):
        assert np.isfinite(values).all()


@given(data=st.data())
def test_a_good_graph_with_some_links_changed(data):
    graph = GOOD.graph.copy()
    cells = st.tuples(st.integers(0, 23), st.integers(0, 3), st.integers(-2, 24))
    changes = data.draw(st.lists(cells, min_size=1, max_size=4))
    for state, action, to in changes:
        graph[state, action] = to
    scene = reads(instead("graph", graph))
    if scene is not None:
        assert (scene.graph == graph).all()  # nothing has been repaired
    moves_only = all(action in (0, 3) and -1 <= to < 24 for _, action, to in changes)
    assert (scene is not None) or not moves_only


NUMBERS = hnp.integer_dtypes() | hnp.unsigned_integer_dtypes() | hnp.floating_dtypes(sizes=(16, 32, 64))


@given(data=st.data(), name=st.sampled_from(["graph", "location", "rotation", "resnet_feature"]))
def test_any_numbers_for_any_dataset(data, name):
    shape = data.draw(hnp.array_shapes(max_dims=4, max_side=25) | st.just(GOOD.features.shape))
    reads(instead(name, data.draw(hnp.arrays(data.draw(NUMBERS), shape))))
