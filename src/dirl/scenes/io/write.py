"""Writing scene dumps, see `dirl.scenes.io.read` for their content; a file is complete or absent."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np
from PIL import Image

from dirl.scenes.graph import ACTIONS, shortest_distances
from dirl.scenes.io.files import atomic_path
from dirl.scenes.io.hdf5 import check_view, write_digest
from dirl.scenes.scene import STORED, Scene, SceneError

MOST_WITH_DISTANCES = 5_000
"""States of a file that holds the distances of all pairs, for other programs; they are recomputed when it is read."""

CROPS = 10
"""Features of a state in the published files. Readers use the first, or draw one; all of ours are the same."""

HEIGHT, WIDTH = 300, 400
"""Of a published view, pixels."""


def write_dump(
    path: str | Path,
    scene: Scene,
    views: Iterable[bytes] | None = None,
    *,
    attributes: Mapping[str, object] | None = None,
    feature_attributes: Mapping[str, str] | None = None,
    patch_attributes: Mapping[str, str] | None = None,
) -> None:
    """Write one scene, completely or not at all.

    Args:
        path: the file to write; an existing one is replaced.
        scene: what to write; its ``views`` are not copied.
        views: N encoded images (WebP, PNG or JPEG bytes), in the order of the states.
        attributes: further file attributes, beside the scene's own.
        feature_attributes: how the features were made: ``extractor``, ``preprocessing``, ``weights``; the scene's own
            description if left out.
        patch_attributes: how the patches were made: ``extractor``, ``projection``.

    Raises:
        SceneError: a view cannot be decoded.
        ValueError: there are not as many views as states.
    """
    path = Path(path)
    with _whole_file(path, scene) as file:
        file.attrs.update({"actions": list(ACTIONS), **(attributes or {})})
        file.create_dataset("graph", data=scene.graph.astype(np.int32), compression="gzip")
        file["location"], file["rotation"] = scene.positions, scene.headings
        if len(scene) <= MOST_WITH_DISTANCES:
            distances = shortest_distances(scene.graph)
            file.create_dataset("shortest_path_distance", data=distances, compression="gzip", shuffle=True)
        if scene.features is not None:
            file["resnet_feature"] = scene.features[:, None]
            file["resnet_feature"].attrs.update(feature_attributes or {"extractor": scene.extractor})
        # In one piece each, so that a reader can map them into memory.
        for attribute, name in STORED.items():
            if (array := getattr(scene, attribute)) is not None:
                file[name] = array.astype(np.float16, copy=False)
        if scene.patches is not None:
            file["patches"].attrs.update(patch_attributes or {})
        if views is None:
            return
        encoded = list(views)
        if len(encoded) != len(scene):
            raise ValueError(f"{path}: {len(encoded)} views for {len(scene)} states")
        stored = file.create_dataset("observation_webp", (len(scene),), h5py.vlen_dtype(np.uint8))
        for state, view in enumerate(encoded):
            check_view(view, f"{path}: the view of state {state} is")  # the reader will trust it with the digest
            stored[state] = np.frombuffer(view, np.uint8)


def export_icra17(scene: Scene, path: str | Path) -> None:
    """Write a scene in the layout of the published files, completely or not at all.

    ``observation`` uint8 ``[N, 300, 400, 3]`` (views of another shape are scaled), ``resnet_feature`` float32
    ``[N, 10, D]``, ``location`` float64 ``[N, 2]``, ``rotation`` int64 ``[N]``, ``graph`` int64 ``[N, 4]`` (ahead,
    right, left, back; -1 = blocked), ``shortest_path_distance`` int64 ``[N, N]`` (-1 = unreachable); nothing is
    compressed. Attributes, which those files lack, keep name, source, goals and extractor for `read_dump`.

    Raises:
        SceneError: something that the layout requires is missing, or does not fit it.
    """
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
    with _whole_file(Path(path), scene) as file:
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


@contextmanager
def _whole_file(path: Path, scene: Scene) -> Iterator[h5py.File]:
    """Open a new dump of a scene; when the context ends it gets its digest and its name, or there is none."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(path) as unfinished, h5py.File(unfinished, "w") as file:
        file.attrs.update({"name": scene.name, "source": scene.source})
        if scene.goals:
            file.attrs["goals"] = np.array(scene.goals)
        yield file
        write_digest(file)
