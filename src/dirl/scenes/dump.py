"""Scene dumps: one HDF5 file a scene, in the layout of the published target-driven navigation code and ours.

| dataset | shape | meaning |
|---|---|---|
| ``graph`` | integer ``[N, 4]`` | next state for ahead, right, left, back; -1 = blocked |
| ``location`` | number ``[N, 2]`` | x, z in metres |
| ``rotation`` | number ``[N]`` | heading in degrees |
| ``resnet_feature`` | float16 or float32 ``[N, D]`` or ``[N, k, D]`` | features; of ``k`` crops the first is used |
| ``shortest_path_distance`` | number ``[N, N]`` | only compared: distances are always recomputed |
| ``observation`` | uint8 ``[N, H, W, 3]`` | raw views (published files) |
| ``observation_webp`` | N byte strings | encoded views (our files) |

``graph``, ``location`` and ``rotation`` are required. File attributes, all optional: ``name``, ``source``, ``goals``
and ``actions`` (the order of the columns of ``graph``, if not the one above). Attributes of ``resnet_feature``:
``extractor``, ``preprocessing``, ``weights``.
"""

import os
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from dirl.scenes.graph import ACTIONS, shortest_distances
from dirl.scenes.scene import Scene, SceneError
from dirl.scenes.views import Views

# What is larger than these is refused before any of it is read.
MAX_STATES = 50_000
MAX_FEATURE_VALUES = 2**29
MAX_PIXELS = 2**24

MAX_COMPARED = 5_000
"""Of a scene with more states the stored distances are not compared; there are states x states of them."""

UNREACHABLE_FROM = 1000
"""Stored distances at or above this mean "unreachable" (some copies of the published files hold 1000)."""

DATASETS = (
    "graph",
    "location",
    "rotation",
    "resnet_feature",
    "shortest_path_distance",
    "observation",
    "observation_webp",
)

EXTRACTOR_ATTRIBUTES = ("extractor", "preprocessing", "weights")


def extractor_text(attributes: Mapping[str, str]) -> str:
    """What made some features, as one text, from the attributes of ``resnet_feature``; empty if there are none."""
    return "; ".join(attributes[key] for key in EXTRACTOR_ATTRIBUTES if attributes.get(key))


class SceneWarning(UserWarning):
    """A dump that can be used but holds something a user should know of."""


def read_dump(path: str | Path, *, name: str | None = None, source: str | None = None) -> Scene:
    """Read and check one scene.

    Nothing large is read before its shape has been checked, and links to other files are refused.

    Args:
        path: the HDF5 file.
        name: what to call the scene; the file's attribute ``name`` or its stem if left out.
        source: where it comes from; the file's attribute ``source`` or "unlabelled" if left out.

    Raises:
        SceneError: the file is missing, truncated, or its content cannot be walked in. The message names the file,
            the dataset, and the first offending state.

    Warns:
        SceneWarning: the stored distances disagree with the graph.
    """
    path = Path(path)
    if not path.is_file():
        raise SceneError(f"{path}: there is no such file")
    try:
        with h5py.File(path) as file:
            return _read(file, path, name, source)
    except SceneError:
        raise
    except (OSError, KeyError, RuntimeError, TypeError, ValueError) as error:  # h5py's for damaged files
        raise SceneError(f"{path}: not a readable HDF5 file, perhaps a broken download ({error})") from None


def _read(file: h5py.File, path: Path, name: str | None, source: str | None) -> Scene:
    missing = [key for key in ("graph", "location", "rotation") if key not in file]
    if missing:
        raise SceneError(f"{path}: the dataset '{missing[0]}' is missing; the file holds {sorted(file)}")
    graph = _dataset(file, path, "graph", kinds="iu", shape=(None, 4))
    states = len(graph)
    if states > MAX_STATES:
        raise SceneError(f"{path}: graph: {states} states are more than the {MAX_STATES} this package can hold")
    location = _dataset(file, path, "location", kinds="iuf", shape=(states, 2))
    rotation = _dataset(file, path, "rotation", kinds="iuf", shape=(states,))
    extractor, features = _features(file, path, states)
    scene = Scene(
        name=name or _attribute(file, path, "name") or path.stem,
        graph=_in_our_order(graph[:], file.attrs.get("actions"), path),
        positions=location[:],
        headings=rotation[:],
        features=features,
        views=_views(file, path, states),
        goals=_goals(file.attrs.get("goals"), path),
        source=source or _attribute(file, path, "source") or "unlabelled",
        extractor=extractor,
        origin=str(path),
    )
    if "shortest_path_distance" in file:
        stored = _dataset(file, path, "shortest_path_distance", kinds="iuf", shape=(states, states))
        if states <= MAX_COMPARED:
            _compare_distances(scene, stored[:], path)
    return scene


def _own(file: h5py.File, path: Path, name: str) -> h5py.Dataset:
    """A dataset of the file itself; nothing of it has been read."""
    if not isinstance(file.get(name, getlink=True), h5py.HardLink):
        raise SceneError(f"{path}: {name}: is a link to elsewhere; a dump must hold its own data")
    dataset = file[name]
    if not isinstance(dataset, h5py.Dataset):
        raise SceneError(f"{path}: {name}: is a group; expected a dataset")
    if dataset.is_virtual or dataset.external:
        raise SceneError(f"{path}: {name}: its data lies in other files; a dump must hold its own data")
    return dataset


def _dataset(file: h5py.File, path: Path, name: str, *, kinds: str, shape: tuple[int | None, ...]) -> h5py.Dataset:
    """A dataset whose place, type and shape are as expected; nothing of it has been read."""
    dataset = _own(file, path, name)
    if dataset.dtype.kind not in kinds:
        names = {"i": "integer", "u": "unsigned integer", "f": "float", "O": "byte string"}
        wanted = " or ".join(names[kind] for kind in kinds)
        raise SceneError(f"{path}: {name}: expected {wanted} values, found {dataset.dtype}")
    found = dataset.shape or ()
    if len(found) != len(shape) or any(w not in (None, f) for w, f in zip(shape, found, strict=True)):
        wanted = ", ".join("any" if size is None else str(size) for size in shape)
        raise SceneError(f"{path}: {name}: expected shape ({wanted}), found {found}")
    return dataset


def _features(file: h5py.File, path: Path, states: int) -> tuple[str, NDArray[Any] | None]:
    """The extractor's description and the features ``[N, D]`` of the first crop."""
    if "resnet_feature" not in file:
        return "none", None
    crops = len(_own(file, path, "resnet_feature").shape or ()) == 3
    shape = (states, None, None) if crops else (states, None)
    dataset = _dataset(file, path, "resnet_feature", kinds="f", shape=shape)
    if 0 in dataset.shape or dataset.size > MAX_FEATURE_VALUES:
        raise SceneError(f"{path}: resnet_feature: unusable shape {dataset.shape}")
    described = {key: _attribute(dataset, path, key) for key in EXTRACTOR_ATTRIBUTES}
    return extractor_text(described) or "unknown", dataset[:, 0] if crops else dataset[:]


def _views(file: h5py.File, path: Path, states: int) -> Views | None:
    if "observation_webp" in file:
        dataset = _dataset(file, path, "observation_webp", kinds="O", shape=(states,))
        if h5py.check_vlen_dtype(dataset.dtype) != np.uint8:
            raise SceneError(f"{path}: observation_webp: expected byte strings (variable-length uint8)")
        return Views(path.resolve(), "observation_webp", states)
    if "observation" in file:
        dataset = _dataset(file, path, "observation", kinds="u", shape=(states, None, None, 3))
        if dataset.dtype != np.uint8:
            raise SceneError(f"{path}: observation: expected uint8 pixels, found {dataset.dtype}")
        if not 0 < dataset.shape[1] * dataset.shape[2] <= MAX_PIXELS:
            raise SceneError(f"{path}: observation: unusable shape {dataset.shape}")
        return Views(path.resolve(), "observation", states)
    return None


def _goals(declared: Any, path: Path) -> tuple[int, ...]:
    goals = np.asarray(() if declared is None else declared)
    if goals.size == 0:
        return ()
    if goals.dtype.kind not in "iu" or goals.ndim > 1:
        raise SceneError(f"{path}: attribute 'goals': expected a list of states (integers), found {declared!r}")
    return tuple(int(goal) for goal in np.atleast_1d(goals))


def _in_our_order(graph: NDArray[Any], declared: Any, path: Path) -> NDArray[Any]:
    if declared is None:
        return graph
    actions = [_text(action) if isinstance(action, str | bytes) else "?" for action in np.atleast_1d(declared)]
    if sorted(actions) != sorted(ACTIONS):
        raise SceneError(
            f"{path}: attribute 'actions': expected {list(ACTIONS)} in the order of graph's columns, found {actions}"
        )
    return graph[:, [actions.index(action) for action in ACTIONS]]


def _compare_distances(scene: Scene, stored: NDArray[Any], path: Path) -> None:
    unreachable = ~np.isfinite(stored) | (stored < 0) | (stored >= UNREACHABLE_FROM)
    stored = np.where(unreachable, -1.0, stored)
    wrong = np.argwhere(stored != scene.distances)
    if len(wrong):
        state, goal = wrong[0]
        warnings.warn(
            f"{path}: shortest_path_distance: {len(wrong)} entries disagree with the graph, first from state {state} "
            f"to {goal}: stored {stored[state, goal]:g}, by search {scene.distances[state, goal]} "
            "(-1 = unreachable); the searched distances are used",
            SceneWarning,
            stacklevel=4,
        )


def _attribute(file: h5py.File | h5py.Dataset, path: Path, name: str) -> str:
    """A text, empty if there is none."""
    value = file.attrs.get(name)
    try:
        return "" if value is None else _text(value)
    except ValueError:
        raise SceneError(f"{path}: attribute '{name}': expected text, found {value!r}") from None


def _text(value: Any) -> str:
    if isinstance(value, bytes):
        return value.decode()
    if not isinstance(value, str):
        raise ValueError(f"{value!r} is no text")
    return value


def write_dump(
    path: str | Path,
    scene: Scene,
    views: Iterable[bytes] | None = None,
    *,
    attributes: dict[str, Any] | None = None,
    feature_attributes: dict[str, str] | None = None,
) -> None:
    """Write one scene; the file appears whole or not at all.

    Args:
        path: the file to write; an existing one is replaced.
        scene: what to write; its ``views`` are not copied.
        views: N encoded images (WebP, PNG or JPEG bytes), in the order of the states.
        attributes: further file attributes, beside the scene's own.
        feature_attributes: how the features were made: ``extractor``, ``preprocessing``, ``weights``; the scene's own
            description if left out.

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
        if encoded is not None:
            stored = file.create_dataset("observation_webp", (len(scene),), h5py.vlen_dtype(np.uint8))
            for state, view in enumerate(encoded):
                stored[state] = np.frombuffer(view, np.uint8)


def replace_features(
    dump: str | Path, path: str | Path, features: NDArray[np.floating], feature_attributes: Mapping[str, str]
) -> None:
    """Write a dump once more with other features; everything else stays as it is, the file attributes too.

    Args:
        dump: a file that `read_dump` accepts; it is not changed.
        path: the file to write; it appears whole or not at all.
        features: of every state, ``[N, D]``.
        feature_attributes: how they were made: ``extractor``, ``preprocessing``, ``weights``.
    """
    with h5py.File(dump) as old, whole_file(Path(path)) as new:
        new.attrs.update(old.attrs)
        for name in DATASETS:
            if name in old and name != "resnet_feature":
                old.copy(name, new)
        new["resnet_feature"] = features[:, None]
        new["resnet_feature"].attrs.update(feature_attributes)


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
