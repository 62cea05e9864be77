"""Scene dumps: one HDF5 file a scene, in the layout of the published target-driven navigation code and ours.

| dataset | shape | meaning |
|---|---|---|
| ``graph`` | integer ``[N, 4]`` | next state for ahead, right, left, back; -1 = blocked |
| ``location`` | number ``[N, 2]`` | x, z in metres |
| ``rotation`` | number ``[N]`` | heading in degrees |
| ``resnet_feature`` | float16 or float32 ``[N, D]`` or ``[N, k, D]`` | features; of ``k`` crops the first is used |
| ``patches`` | float16 ``[N, cells, channels]`` | what each part of each view shows (our files) |
| ``shortest_path_distance`` | number ``[N, N]`` | only compared: distances are always recomputed |
| ``observation`` | uint8 ``[N, H, W, 3]`` | raw views (published files) |
| ``observation_webp`` | N byte strings | encoded views (our files) |

``graph``, ``location`` and ``rotation`` are required. File attributes, all optional: ``name``, ``source``, ``goals``
and ``actions`` (the order of the columns of ``graph``, if not the one above). Attributes of ``resnet_feature``:
``extractor``, ``preprocessing``, ``weights``.
"""

import math
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from dirl.scenes.graph import ACTIONS
from dirl.scenes.scene import Scene, SceneError
from dirl.scenes.views import MAX_PIXELS, Views

# What is larger than these is refused before any of it is read.
MAX_STATES = 50_000
MAX_FEATURE_VALUES = 2**27
"""Of the first crop, the one that is read: half a gigabyte as float32."""
MAX_CHUNK_BYTES = 2**28
"""HDF5 unpacks a whole chunk to read any value in it, and a small file can hold a chunk of gigabytes."""
MAX_FREELY_UNPACKED, MAX_RATIO = 2**26, 500
"""Bytes; and how much larger than in the file more than that may become. (gzip packs zeros a thousand times.)"""
MAX_NAME, MAX_TEXT = 100, 2000
"""Characters of the scene's name, which file names are made of, and of other texts."""

MAX_COMPARED = 5_000
"""Of a scene with more states distances are neither stored nor compared; there are states x states of them."""

UNREACHABLE_FROM = 1000
"""Stored distances at or above this mean "unreachable" (some copies of the published files hold 1000)."""

DATASETS = (
    "graph",
    "location",
    "rotation",
    "resnet_feature",
    "patches",
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
    for dataset in (graph, location, rotation):
        _check_storage(dataset, path)
    extractor, features = _features(file, path, states)
    scene = Scene(
        name=name or _name(file, path) or path.stem,
        graph=_in_our_order(graph[:], file.attrs.get("actions"), path),
        positions=location[:],
        headings=rotation[:],
        features=features,
        views=_views(file, path, states),
        goals=_goals(file.attrs.get("goals"), path),
        source=source or _attribute(file, path, "source") or "unlabelled",
        extractor=extractor,
        origin=str(path),
        patches=_patches(file, path, states),
    )
    if "shortest_path_distance" in file:
        stored = _dataset(file, path, "shortest_path_distance", kinds="iuf", shape=(states, states))
        if states <= MAX_COMPARED:
            _check_storage(stored, path)
            _compare_distances(scene, stored[:], path)
    return scene


def _own(file: h5py.File, path: Path, name: str) -> h5py.Dataset:
    """A dataset of the file itself; nothing of it has been read."""
    if not isinstance(file.get(name, getlink=True), h5py.HardLink):
        raise SceneError(f"{path}: {name}: is a link to elsewhere; a dump must hold its own data")
    dataset = file[name]
    if not isinstance(dataset, h5py.Dataset):
        raise SceneError(f"{path}: {name}: is a {type(dataset).__name__.lower()}; expected a dataset")
    if dataset.is_virtual or dataset.external:
        raise SceneError(f"{path}: {name}: its data lies in other files; a dump must hold its own data")
    return dataset


def _check_storage(dataset: h5py.Dataset, path: Path) -> None:
    """Check that all of a dataset's values have been written, in pieces of sensible size."""
    name = dataset.name.removeprefix("/")
    if dataset.chunks is None:
        unwritten = dataset.size and not dataset.id.get_storage_size()
    else:
        size = math.prod(dataset.chunks) * dataset.dtype.itemsize
        if size > MAX_CHUNK_BYTES:
            raise SceneError(
                f"{path}: {name}: is stored in chunks of {dataset.chunks}, {size} bytes each; at most {MAX_CHUNK_BYTES}"
            )
        pieces = math.prod(-(-length // chunk) for length, chunk in zip(dataset.shape, dataset.chunks, strict=True))
        unwritten = dataset.id.get_num_chunks() < pieces
    if unwritten:
        raise SceneError(f"{path}: {name}: some of its values were never written; was its making stopped?")
    layout = dataset.id.get_create_plist()
    for index in range(layout.get_nfilters()):
        code = layout.get_filter(index)[0]
        if not h5py.h5z.filter_avail(code):
            raise SceneError(
                f"{path}: {name}: is compressed in a way that is not installed here (HDF5 filter {code}); store it "
                "with gzip, or install the filter"
            )
    packed = dataset.id.get_storage_size()
    if dataset.nbytes > max(MAX_FREELY_UNPACKED, MAX_RATIO * packed):
        raise SceneError(
            f"{path}: {name}: {packed} bytes would unpack to {dataset.nbytes}; no such data compresses as well"
        )


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
    if 0 in dataset.shape or states * dataset.shape[-1] > MAX_FEATURE_VALUES:
        raise SceneError(
            f"{path}: resnet_feature: expected at least one feature a state, and {MAX_FEATURE_VALUES} of all at most, "
            f"found shape {dataset.shape}"
        )
    _check_storage(dataset, path)
    described = {key: _attribute(dataset, path, key) for key in EXTRACTOR_ATTRIBUTES}
    return extractor_text(described) or "unknown", dataset[:, 0] if crops else dataset[:]


def _patches(file: h5py.File, path: Path, states: int) -> NDArray[np.float16] | None:
    """Mapped from the file, so that many scenes cost no memory, if they are stored in one piece as we write them."""
    if "patches" not in file:
        return None
    dataset = _dataset(file, path, "patches", kinds="f", shape=(states, None, None))
    if dataset.dtype != np.float16 or 0 in dataset.shape or dataset.size > MAX_FEATURE_VALUES:
        raise SceneError(
            f"{path}: patches: expected float16 values, at most {MAX_FEATURE_VALUES} of them, found {dataset.dtype} "
            f"{dataset.shape}"
        )
    _check_storage(dataset, path)
    offset = dataset.id.get_offset()
    if offset is None:
        return dataset[:]
    return np.memmap(path, np.float16, "r", offset, dataset.shape)


def _views(file: h5py.File, path: Path, states: int) -> Views | None:
    if "observation_webp" in file:
        dataset = _dataset(file, path, "observation_webp", kinds="O", shape=(states,))
        if h5py.check_vlen_dtype(dataset.dtype) != np.uint8:
            raise SceneError(f"{path}: observation_webp: expected byte strings (variable-length uint8)")
        _check_storage(dataset, path)
        return Views(path.resolve(), "observation_webp", states)
    if "observation" in file:
        dataset = _dataset(file, path, "observation", kinds="u", shape=(states, None, None, 3))
        if dataset.dtype != np.uint8:
            raise SceneError(f"{path}: observation: expected uint8 pixels, found {dataset.dtype}")
        if not 0 < dataset.shape[1] * dataset.shape[2] <= MAX_PIXELS:
            raise SceneError(
                f"{path}: observation: expected 1 to {MAX_PIXELS} pixels a view, found shape {dataset.shape}"
            )
        _check_storage(dataset, path)
        return Views(path.resolve(), "observation", states)
    return None


def _goals(declared: Any, path: Path) -> tuple[int, ...]:
    goals = np.asarray(() if declared is None else declared)
    if goals.size == 0:
        return ()
    if goals.dtype.kind not in "iu" or goals.ndim > 1:
        raise SceneError(f"{path}: attribute 'goals': expected a list of states (integers), found {_short(declared)}")
    states = np.atleast_1d(goals).tolist()
    twice = [goal for goal in states if states.count(goal) > 1]
    if twice:
        raise SceneError(f"{path}: attribute 'goals': names state {twice[0]} twice")
    return tuple(states)


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
        text = "" if value is None else _text(value)
    except ValueError:
        raise SceneError(f"{path}: attribute '{name}': expected text, found {_short(value)}") from None
    if not text.isprintable() or len(text) > MAX_TEXT:
        raise SceneError(f"{path}: attribute '{name}': expected one line of text, found {_short(text)}")
    return text


def _name(file: h5py.File, path: Path) -> str:
    """The scene's name, fit to be part of a file's name; empty if there is none."""
    name = _attribute(file, path, "name")
    if len(name) > MAX_NAME or "/" in name or "\\" in name:
        raise SceneError(
            f"{path}: attribute 'name': expected at most {MAX_NAME} characters without slashes, found {_short(name)}"
        )
    return name


def _short(value: Any) -> str:
    """A value of a file for a message, on one line."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:60]}..."


def _text(value: Any) -> str:
    if isinstance(value, bytes):
        return value.decode()
    if not isinstance(value, str):
        raise ValueError(f"{value!r} is no text")
    return value
