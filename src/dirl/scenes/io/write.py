"""Writing scene dumps, see `dirl.scenes.io.read` for their content; a file is complete or absent."""

import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from dirl.scenes.graph import ACTIONS, shortest_distances
from dirl.scenes.io.atomic import atomic_path
from dirl.scenes.io.datasets import check_view
from dirl.scenes.io.digest import DATASETS, write_digest
from dirl.scenes.io.hdf5 import MAX_COMPARED
from dirl.scenes.io.isolation import call_apart
from dirl.scenes.scene import Scene, SceneError, check_name


def write_dump(
    path: str | Path,
    scene: Scene,
    views: Iterable[bytes] | None = None,
    *,
    attributes: dict[str, Any] | None = None,
    feature_attributes: dict[str, str] | None = None,
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
        SceneError: the scene's name is not allowed, or a view cannot be decoded.
        ValueError: there are not as many views as states.
    """
    path = Path(path)
    check_name(scene.name, str(path))
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
        # In one piece each, so that a reader can map them into memory.
        large = {
            "patches": scene.patches,
            "look_feature": scene.look_features,
            "look_patches": scene.look_patches,
            "along_feature": scene.along,
        }
        for name, array in large.items():
            if array is not None:
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


def replace_features(
    dump: str | Path,
    path: str | Path,
    features: NDArray[np.floating],
    feature_attributes: Mapping[str, str],
    patches: NDArray[np.float16] | None = None,
    patch_attributes: Mapping[str, str] | None = None,
) -> None:
    """Write a copy of a dump with other features ``[N, D]``; everything else stays, file attributes included.

    Patches ``[N, cells, channels]`` are those of the dump if left out. Attributes are those of `write_dump`.
    `SceneError` if the dump cannot be copied.
    """
    arrays: dict[str, NDArray[Any]] = {"resnet_feature": features[:, None]}
    attributes = {"resnet_feature": dict(feature_attributes)}
    if patches is not None:
        arrays["patches"] = patches
        attributes["patches"] = dict(patch_attributes or {})
    with TemporaryDirectory() as folder:
        files = {name: os.path.abspath(Path(folder) / f"{name}.npy") for name in arrays}
        for name, array in arrays.items():
            np.save(files[name], array)
        call = {"path": os.path.abspath(dump), "to": os.path.abspath(path), "arrays": files, "attributes": attributes}
        try:
            list(call_apart("dirl.scenes.io.write:copy_with", [call]))
        except SceneError as error:
            raise SceneError(f"{dump}: {error}") from None


def copy_with(
    path: str, to: str, arrays: Mapping[str, str], attributes: Mapping[str, Mapping[str, str]]
) -> dict[str, Any]:
    """Write a copy of a dump with other values, of ``.npy`` files, and attributes of the named datasets.

    Returns nothing by any name, as `call_apart` wants it.
    """
    with h5py.File(path) as old, whole_file(Path(to)) as new:
        new.attrs.update(old.attrs)
        # Of further looks and arrows the file has no views to encode anew.
        left = {*arrays, "look_feature", "look_patches", "along_feature"}
        for name in DATASETS:
            if name in old and name not in left:
                old.copy(name, new)
        for name, file in arrays.items():
            new[name] = np.load(file, mmap_mode="r")
            new[name].attrs.update(attributes[name])
    return {}


@contextmanager
def whole_file(path: Path) -> Iterator[h5py.File]:
    """A new dump to write to; when the context ends it gets its digest and its name. If it fails there is no file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(path) as unfinished, h5py.File(unfinished, "w") as file:
        yield file
        write_digest(file)
