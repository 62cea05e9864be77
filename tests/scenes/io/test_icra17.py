"""Export to the published layout, and import of it: nothing is lost."""

from dataclasses import replace

import h5py
import numpy as np
import pytest
from rooms import grid_scene, read_here

from dirl.scenes import SceneError, write_dump
from dirl.scenes.io.write import export_icra17
from dirl.scenes.views import encode

PARTS = ("graph", "positions", "headings", "distances", "features")


def with_views(folder, scene, height=300, width=400):
    views = [encode(np.full((height, width, 3), 3 * state, np.uint8)) for state in range(len(scene))]
    write_dump(folder / "views.h5", scene, views)
    return read_here(folder / "views.h5")


def test_the_layout_is_the_published_one(tmp_path, scene):
    export_icra17(with_views(tmp_path, scene), tmp_path / "out.h5")
    with h5py.File(tmp_path / "out.h5") as file:
        layout = {name: (dataset.shape, dataset.dtype.str) for name, dataset in file.items()}
        assert layout == {
            "graph": ((24, 4), "<i8"),
            "location": ((24, 2), "<f8"),
            "observation": ((24, 300, 400, 3), "|u1"),
            "resnet_feature": ((24, 10, 16), "<f4"),
            "rotation": ((24,), "<i8"),
            "shortest_path_distance": ((24, 24), "<i8"),
        }
        assert all(dataset.chunks is None for dataset in file.values())
        assert set(np.unique(file["rotation"])) == {0, 90, 180, 270}
        assert (file["graph"][:] == scene.graph).all()
        assert file["graph"][:].min() == -1
        assert (file["resnet_feature"][:] == scene.features[:, None]).all()  # each crop, as public code may draw one


@pytest.mark.parametrize(("dtype", "headings"), [("f4", 12)])
def test_an_export_is_read_back_equal(tmp_path, dtype, headings):
    room = grid_scene(3, 2, goals=(3, 1), headings=headings, blocked=[(1, 0)], name="hall", extractor="net; 1; 2")
    room = with_views(tmp_path, replace(room, features=room.features.astype(dtype), source="photos"))
    export_icra17(room, tmp_path / "out.h5")
    read = read_here(tmp_path / "out.h5")
    for part in PARTS:
        assert (getattr(read, part) == getattr(room, part)).all(), part
    assert (read.name, read.goals, read.source, read.extractor) == ("hall", (3, 1), "photos", "net; 1; 2")
    for state in range(len(room)):
        assert (read.views[state] == room.views[state]).all()
    export_icra17(with_views(tmp_path, room, 60, 80), tmp_path / "scaled.h5")
    assert read_here(tmp_path / "scaled.h5").views[7].shape == (300, 400, 3)


def test_what_the_layout_cannot_hold_is_refused(tmp_path, scene):
    whole = with_views(tmp_path, scene)
    odd = grid_scene(headings=16)
    cases = [
        (replace(whole, views=None), "has no views"),
        (replace(whole, features=None), "has no features .*; encode its views first"),
        (
            replace(odd, views=replace(whole.views, spans=np.zeros((len(odd), 2), int))),
            "rotation: state 1 is headed 22.5 degrees",
        ),
    ]
    for room, says in cases:
        with pytest.raises(SceneError, match=says):
            export_icra17(room, tmp_path / "out.h5")
        assert not (tmp_path / "out.h5").exists()
