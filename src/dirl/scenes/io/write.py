"""Writing scene dumps, see `dirl.scenes.io.read` for what is in them; a file is whole or not there."""

import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from dirl.scenes.graph import ACTIONS, shortest_distances
from dirl.scenes.io.read import DATASETS, MAX_COMPARED
from dirl.scenes.scene import Scene


def write_dump(
    path: str | Path,
    scene: Scene,
    views: Iterable[bytes] | None = None,
    *,
    attributes: dict[str, Any] | None = None,
    feature_attributes: dict[str, str] | None = None,
    patch_attributes: Mapping[str, str] | None = None,
) -> None:
    """Write one scene; the file appears whole or not at all.

    Args:
        path: the file to write; an existing one is replaced.
        scene: what to write; its ``views`` are not copied.
        views: N encoded images (WebP, PNG or JPEG bytes), in the order of the states.
        attributes: further file attributes, beside the scene's own.
        feature_attributes: how the features were made: ``extractor``, ``preprocessing``, ``weights``; the scene's own
            description if left out.
        patch_attributes: how the patches were made.

    Raises:
        ValueError: there are not as many views as states.
    """
    path = Path(path)
    encoded = None if views is None else list(views)
    if encoded is not None and len(encoded) != len(scene):
        raise ValueError(f"{path}: {len(encoded)} views for {len(scene)} states")
    with whole_file(path) as file:
        file.attrs.update({"name": scene.name, "source": scene.source, "actions": list(ACTIONS)})
        file.attrs.update(attributes or {})
        if scene.goals:
            file.attrs["goals"] = np.array(scene.goals)
        file.create_dataset("graph", data=scene.graph.astype(np.int32), compression="gzip")
        file["location"], file["rotation"] = scene.positions, scene.headings
        if len(scene) <= MAX_COMPARED:
            distances = shortest_distances(scene.graph)
            file.create_dataset("shortest_path_distance", data=distances, compression="gzip", shuffle=True)
        if scene.features is not None:
            file["resnet_feature"] = scene.features[:, None]
            file["resnet_feature"].attrs.update(feature_attributes or {"extractor": scene.extractor})
        if scene.patches is not None:
            _store_patches(file, scene.patches, patch_attributes)
        if encoded is not None:
            stored = file.create_dataset("observation_webp", (len(scene),), h5py.vlen_dtype(np.uint8))
            for state, view in enumerate(encoded):
                stored[state] = np.frombuffer(view, np.uint8)


def replace_features(
    dump: str | Path,
    path: str | Path,
    features: NDArray[np.floating],
    feature_attributes: Mapping[str, str],
    patches: NDArray[np.float16] | None = None,
    patch_attributes: Mapping[str, str] | None = None,
) -> None:
    """Write a dump once more with other features; everything else stays as it is, the file attributes too.

    Args:
        dump: a file that `read_dump` accepts; it is not changed.
        path: the file to write; it appears whole or not at all.
        features: of every state, ``[N, D]``.
        feature_attributes: how they were made: ``extractor``, ``preprocessing``, ``weights``.
        patches: of every state, ``[N, cells, channels]``; those of the dump if left out.
        patch_attributes: how they were made.
    """
    replaced = {"resnet_feature"} if patches is None else {"resnet_feature", "patches"}
    with h5py.File(dump) as old, whole_file(Path(path)) as new:
        new.attrs.update(old.attrs)
        for name in DATASETS:
            if name in old and name not in replaced:
                old.copy(name, new)
        new["resnet_feature"] = features[:, None]
        new["resnet_feature"].attrs.update(feature_attributes)
        if patches is not None:
            _store_patches(new, patches, patch_attributes)


def _store_patches(file: h5py.File, patches: NDArray[np.float16], attributes: Mapping[str, str] | None) -> None:
    """In one piece and as they are, so that a reader can map them into memory."""
    file["patches"] = patches
    file["patches"].attrs.update(attributes or {})


@contextmanager
def whole_file(path: Path) -> Iterator[h5py.File]:
    """A new HDF5 file to write to; it stands at ``path`` when the context ends, and not at all if that fails."""
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(path.name + ".tmp")
    try:
        with h5py.File(unfinished, "w") as file:
            yield file
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)
