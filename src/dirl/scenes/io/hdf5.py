"""The content of a dump, read with libhdf5; `dirl.scenes.io.read` says what is in such a file.

Everything here also runs in a separate process, see `dirl.scenes.io.isolation`, and so does without torch. Errors do
not name the file; the caller adds its name.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from dirl.scenes.graph import ACTIONS, GraphError, check_graph, shortest_distances
from dirl.scenes.io.datasets import (
    check_storage,
    locate_mapped,
    locate_views,
    open_dataset,
    open_views,
    own_dataset,
    read_attribute,
    short,
)
from dirl.scenes.io.digest import EXTRACTOR_ATTRIBUTES, blocks, check_digest
from dirl.scenes.scene import SceneError

# What is larger than these is refused before any of it is read.
MAX_STATES = 50_000
MAX_FEATURE_VALUES = 2**27
"""Of the first crop, the one that is read: half a gigabyte as float32."""
MAX_FEATURE_RATIO = 50
"""How much larger than in the file features may be; those of a network hardly compress."""
MAX_TEXT = 2000
"""Characters of an attribute."""

MAX_COMPARED = 5_000
"""Of a scene with more states distances are neither stored nor compared; there are states x states of them."""
COMPARED_GOALS = 1_000
"""The stored distances to that many states, evenly spread, are compared."""

UNREACHABLE_FROM = 1000
"""Stored distances at or above this mean "unreachable" (some copies of the published files hold 1000)."""


def read_contents(path: str | Path, *, intact: bool = False) -> dict[str, Any]:
    """Read a dump. Nothing large is read before its shape has been checked, and links to other files are refused.

    Args:
        path: an existing file.
        intact: its bytes are known to be those that were written; its digest and its views need no check.

    Returns:
        Arguments of `dirl.scenes.Scene`, not yet checked, texts empty where the file does not say; where large arrays
        lie (``mapped``); arguments of `dirl.scenes.Views`, if there are views; and a ``warning``, maybe empty.
    """
    try:
        with h5py.File(path) as file, np.errstate(all="ignore"):
            return _read(file, Path(path), intact)
    except SceneError:
        raise
    except Exception as error:  # h5py raises nearly every kind for damaged files
        raise SceneError(unreadable(error)) from None


def unreadable(error: Exception) -> str:
    """Return in one line why h5py cannot read a file, and what to do."""
    reason = " ".join(str(error).split())[:200]
    if isinstance(error, MemoryError) or "Cannot allocate memory" in reason or "memory allocation failed" in reason:
        return "takes more memory than there is for a dump; it is damaged, or other programs need the memory"
    if isinstance(error, BlockingIOError) or "unable to lock file" in reason:
        return "another program has it open and locked; close it there, or set HDF5_USE_FILE_LOCKING=FALSE"
    return f"not a readable HDF5 file, perhaps a broken download ({reason})"


def extractor_text(attributes: Mapping[str, str]) -> str:
    """What made some features, as one text, from the attributes of ``resnet_feature``; empty if there are none."""
    return "; ".join(attributes[key] for key in EXTRACTOR_ATTRIBUTES if attributes.get(key))


def _read(file: h5py.File, path: Path, intact: bool) -> dict[str, Any]:
    missing = [key for key in ("graph", "location", "rotation") if key not in file]
    if missing:
        raise SceneError(f"the dataset '{missing[0]}' is missing; the file holds {short(sorted(file), str)}")
    graph = open_dataset(file, "graph", kinds="iu", shape=(None, 4))
    states = len(graph)
    if states > MAX_STATES:
        raise SceneError(f"graph: {states} states are more than the {MAX_STATES} this package can hold")
    location = open_dataset(file, "location", kinds="iuf", shape=(states, 2))
    rotation = open_dataset(file, "rotation", kinds="iuf", shape=(states,))
    for dataset in (graph, location, rotation):
        check_storage(dataset)
    features = _open_features(file, states)
    views = open_views(file, states)
    mapped = locate_mapped(file, path, states)
    distances = None
    if "shortest_path_distance" in file:
        distances = open_dataset(file, "shortest_path_distance", kinds="iuf", shape=(states, states))
        if states <= MAX_COMPARED:
            check_storage(distances)
    verified = intact or check_digest(file)
    contents = {
        "graph": _in_our_order(graph[:], read_attribute(file, "actions")),
        "positions": location[:],
        "headings": rotation[:],
        "features": None if features is None else _read_features(features, path, mapped=intact),
        "extractor": "none"
        if features is None
        else extractor_text({key: _text_attribute(features, key) for key in EXTRACTOR_ATTRIBUTES}) or "unknown",
        "name": _text_attribute(file, "name"),
        "source": _text_attribute(file, "source"),
        "goals": _goals(read_attribute(file, "goals"), states),
        "mapped": mapped,
        "warning": "",
        **({} if views is None else locate_views(views, path, decoded=verified)),
    }
    _check_differences(contents["headings"], contents["features"])
    if distances is not None and states <= MAX_COMPARED and not verified:
        contents["warning"] = _compare_distances(contents["graph"], distances)
    return contents


def _open_features(file: h5py.File, states: int) -> h5py.Dataset | None:
    if "resnet_feature" not in file:
        return None
    crops = len(own_dataset(file, "resnet_feature").shape or ()) == 3
    shape = (states, None, None) if crops else (states, None)
    dataset = open_dataset(file, "resnet_feature", kinds="f", shape=shape)
    if crops and dataset.shape[1] > dataset.shape[2]:
        raise SceneError(
            f"resnet_feature: {dataset.shape[1]} crops of {dataset.shape[2]} features; expected shape (states, crops, "
            "features); is it the other way round?"
        )
    if 0 in dataset.shape or states * dataset.shape[-1] > MAX_FEATURE_VALUES:
        raise SceneError(
            f"resnet_feature: expected at least one feature a state, and {MAX_FEATURE_VALUES} of all at most, "
            f"found shape {dataset.shape}"
        )
    check_storage(dataset, max_ratio=MAX_FEATURE_RATIO)
    return dataset


def _read_features(dataset: h5py.Dataset, path: Path, *, mapped: bool) -> NDArray[np.floating]:
    """Return the features ``[N, D]`` of the first crop, a block at a time: float64 would take three times the memory.

    Those of a file as we write it are memory-mapped on request: a world copies them, and then they need no memory.
    """
    offset = dataset.id.get_offset()
    if mapped and offset is not None and dataset.dtype in (np.float16, np.float32):
        stored = np.memmap(path, dataset.dtype, "r", offset, dataset.shape)
        return stored[:, 0] if dataset.ndim == 3 else stored
    kind = np.float16 if dataset.dtype.itemsize == 2 else np.float32
    values = np.empty((dataset.shape[0], dataset.shape[-1]), kind)
    for rows in blocks(dataset):
        values[rows] = dataset[rows, 0] if dataset.ndim == 3 else dataset[rows]
    return values


def _check_differences(headings: NDArray[Any], features: NDArray[np.floating] | None) -> None:
    """Check that states differ in their headings and features."""
    if len(headings) > 1 and (headings == headings[0]).all():
        raise SceneError(f"rotation: all states have the heading {headings[0]:g}; a turn must change it")
    if features is None or len(features) < 2 or not np.isfinite(features[0]).all():
        return
    if all(np.array_equal(row, features[0]) for row in features):
        raise SceneError("resnet_feature: all states have the same features; nothing could be told apart")


def _goals(declared: Any, states: int) -> list[int]:
    goals = np.asarray(() if declared is None else declared)
    if goals.size == 0:
        return []
    if goals.dtype.kind not in "iu" or goals.ndim > 1:
        raise SceneError(f"attribute 'goals': expected a list of states (integers), found {short(declared)}")
    named = np.atleast_1d(goals)
    if len(named) > states:
        raise SceneError(f"attribute 'goals': names {len(named)} goals of {states} states")
    values, counts = np.unique(named, return_counts=True)
    if (counts > 1).any():
        raise SceneError(f"attribute 'goals': names state {values[counts > 1][0]} twice")
    return named.tolist()


def _in_our_order(graph: NDArray[Any], declared: Any) -> NDArray[Any]:
    if declared is None:
        return graph
    actions = [_text(action) if isinstance(action, str | bytes) else "?" for action in np.atleast_1d(declared).tolist()]
    if sorted(actions) != sorted(ACTIONS):
        raise SceneError(
            f"attribute 'actions': expected {list(ACTIONS)} in the order of graph's columns, found "
            f"{short(actions) if len(actions) > 5 else actions}"
        )
    return graph[:, [actions.index(action) for action in ACTIONS]]


def _compare_distances(graph: NDArray[Any], dataset: h5py.Dataset) -> str:
    """Return the problem with the stored distances; empty if there is none, or if the graph itself is invalid."""
    links = graph.astype(np.int64)
    try:
        check_graph(links)
    except GraphError:
        return ""
    goals = np.unique(np.linspace(0, len(links) - 1, COMPARED_GOALS).astype(np.int64))
    distances = shortest_distances(links, goals)
    stored = np.concatenate([dataset[rows][:, goals] for rows in blocks(dataset)])
    unreachable = ~np.isfinite(stored) | (stored < 0) | (stored >= UNREACHABLE_FROM)
    wrong = np.argwhere(np.where(unreachable, -1.0, stored) != distances)
    if not len(wrong):
        return ""
    state, column = wrong[0]
    return (
        f"shortest_path_distance: {len(wrong)} entries disagree with the graph, first from state {state} to "
        f"{goals[column]}: stored {-1 if unreachable[state, column] else stored[state, column]:g}, by search "
        f"{distances[state, column]} (-1 = unreachable); the searched distances are used"
    )


def _text_attribute(holder: h5py.File | h5py.Dataset, name: str) -> str:
    """Return a text, empty if there is none."""
    value = read_attribute(holder, name)
    try:
        text = "" if value is None else _text(value)
    except ValueError:
        raise SceneError(f"attribute '{name}': expected text, found {short(value)}") from None
    if not text.isprintable() or len(text) > MAX_TEXT:
        raise SceneError(f"attribute '{name}': expected one line of text, found {short(text)}")
    return text


def _text(value: Any) -> str:
    if isinstance(value, bytes):
        return value.decode()
    if not isinstance(value, str):
        raise ValueError(f"{value!r} is no text")
    return str(value)
