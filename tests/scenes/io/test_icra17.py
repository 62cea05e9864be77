"""Export to the published layout, and import of it: nothing is lost."""

from dataclasses import replace

import h5py
import numpy as np
from refusals import refused
from rooms import grid_scene, read_here

from dirl.scenes import write_dump
from dirl.scenes.io.write import export_icra17
from dirl.scenes.views import encode


def with_views(folder, scene, height=300, width=400):
    views = [encode(np.full((height, width, 3), 3 * state, np.uint8)) for state in range(len(scene))]
    write_dump(folder / "views.h5", scene, views)
    return read_here(folder / "views.h5")


def test_the_layout_is_the_published_one(tmp_path, scene):
    export_icra17(with_views(tmp_path, scene, 60, 80), tmp_path / "out.h5")  # which are scaled
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
        assert np.abs(file["observation"][:, 150, 200].astype(int) - 3 * np.arange(24)[:, None]).max() <= 3
        assert (file.attrs["source"], file["resnet_feature"].attrs["extractor"]) == ("synthetic", "random")


def test_what_the_layout_cannot_hold_is_refused(tmp_path, scene):
    whole = with_views(tmp_path, scene)
    odd = grid_scene(headings=16)
    odd = replace(odd, views=replace(whole.views, spans=np.zeros((len(odd), 2), int)))
    cases = [
        (replace(whole, views=None), "has no views"),
        (replace(whole, features=None), "has no features .*; encode its views first"),
        (odd, "rotation: state 1 is headed 22.5 degrees"),
    ]
    for room, says in cases:
        refused(says, export_icra17, room, tmp_path / "out.h5")
        assert not (tmp_path / "out.h5").exists()
