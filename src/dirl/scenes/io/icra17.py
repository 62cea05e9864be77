"""Export of scenes for other programs: the layout of the published target-driven navigation code (ICRA 2017)."""

from pathlib import Path

import numpy as np
from PIL import Image

from dirl.scenes.io.write import MOST_WITH_DISTANCES, whole_file
from dirl.scenes.scene import Scene, SceneError, check_name

CROPS = 10
"""Features of a state in the published files. Readers use the first, or draw one; all of ours are the same."""

HEIGHT, WIDTH = 300, 400
"""Of a published view, pixels."""


def export_icra17(scene: Scene, path: str | Path) -> None:
    """Write a scene in the layout of the published files, completely or not at all.

    ``observation`` uint8 ``[N, 300, 400, 3]`` (views of another shape are scaled), ``resnet_feature`` float32
    ``[N, 10, D]``, ``location`` float64 ``[N, 2]``, ``rotation`` int64 ``[N]``, ``graph`` int64 ``[N, 4]`` (ahead,
    right, left, back; -1 = blocked), ``shortest_path_distance`` int64 ``[N, N]`` (-1 = unreachable); nothing is
    compressed. Attributes, which those files lack, keep name, source, goals and extractor for `read_dump`.

    Raises:
        SceneError: something that the layout requires is missing, or does not fit it.
    """
    check_name(scene.name, str(path))
    if scene.views is None:
        raise SceneError(f"{scene.origin}: has no views (observation), which the layout icra17 requires")
    if scene.features is None:
        raise SceneError(f"{scene.origin}: has no features (resnet_feature); encode its views first")
    if len(scene) > MOST_WITH_DISTANCES:
        raise SceneError(
            f"{scene.origin}: {len(scene)} states; the layout icra17 holds the distances of all pairs, which is "
            f"sensible up to {MOST_WITH_DISTANCES}"
        )
    headings = scene.headings.round().astype(np.int64)
    between = np.flatnonzero(headings != scene.headings)
    if len(between):
        state = between[0]
        raise SceneError(
            f"{scene.origin}: rotation: state {state} is headed {scene.headings[state]:g} degrees; the layout icra17 "
            "holds whole degrees"
        )
    with whole_file(Path(path)) as file:
        file.attrs.update({"name": scene.name, "source": scene.source})
        if scene.goals:
            file.attrs["goals"] = np.array(scene.goals)
        file["graph"] = scene.graph
        file["location"] = scene.positions
        file["rotation"] = headings
        file["shortest_path_distance"] = scene.distances.astype(np.int64)
        file["resnet_feature"] = np.repeat(scene.features[:, None].astype(np.float32), CROPS, axis=1)
        file["resnet_feature"].attrs["extractor"] = scene.extractor
        stored = file.create_dataset("observation", (len(scene), HEIGHT, WIDTH, 3), np.uint8)
        for state in range(len(scene)):
            view = scene.views[state]
            if view.shape[:2] != (HEIGHT, WIDTH):
                view = np.asarray(Image.fromarray(view).resize((WIDTH, HEIGHT), Image.Resampling.BILINEAR))
            stored[state] = view
