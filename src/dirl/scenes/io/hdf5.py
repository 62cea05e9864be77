"""The content of a dump, read with libhdf5, and its digest; `dirl.scenes.io.read` says what is in such a file.

Everything here also runs in a separate process, see `dirl.scenes.io.read`, and so does without torch. Errors do
not name the file; the caller adds its name.
"""

import hashlib
import json
import math
import mmap
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from dirl.scenes.graph import ACTIONS, IntArray
from dirl.scenes.scene import STORED, SceneError
from dirl.scenes.views import MAX_PIXELS, ImageError, decode

# What is larger than these is refused before any of it is read.
MAX_STATES = 50_000
MAX_FEATURE_VALUES = 2**27
"""Of the first crop, the one that is read: half a gigabyte as float32."""
MAX_TEXT = 2000
"""Characters of an attribute."""
MAX_UNPACKED_VIEWS = 2**29
"""Bytes of raw views that are compressed in the file, for they are held in memory."""
MAX_VALUES = 2**27
"""Of a mapped array: a quarter of a gigabyte."""
AT_A_TIME = 256
"""Encoded views that are read from a dataset at once."""
COLLECTIONS = 16
"""Of values of variable length, to which libhdf5 adds in turn (HDF5 file format, version 3, III.E)."""

DATASETS = (
    *("graph", "location", "rotation", "resnet_feature", *STORED.values()),
    *("shortest_path_distance", "observation", "observation_webp"),
)

FILE_ATTRIBUTES = ("name", "source", "goals", "actions")
EXTRACTOR_ATTRIBUTES = ("extractor", "preprocessing", "weights")
PATCH_ATTRIBUTES = ("extractor", "projection")

DIGEST = "digest"
"""The attribute of a dump; ``graph`` has it too, for damage can also make attributes disappear."""

BLOCK_BYTES = 2**24

Contents = dict[str, Any]
"""Of a dump: arrays, texts and where large arrays lie, see `read_contents`."""

KINDS = {"i": "integer", "u": "unsigned integer", "f": "float", "O": "byte string"}


def read_contents(path: str | Path, *, intact: bool = False) -> Contents:
    """Read a dump. Nothing large is read before its shape has been checked, and links to other files are refused.

    Of an ``intact`` one, whose bytes are known to be those that were written, digest and views need no check.

    Returns:
        Arguments of `dirl.scenes.Scene`, not yet checked, texts empty where the file does not say; where large arrays
        lie (``mapped``); and arguments of `dirl.scenes.views.FileViews`, if there are views.
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
    if "required filter" in reason:
        return f"is compressed in a way that is not installed here ({reason}); store it with gzip"
    return f"not a readable HDF5 file, perhaps a broken download ({reason})"


def _read(file: h5py.File, path: Path, intact: bool) -> Contents:
    missing = [key for key in ("graph", "location", "rotation") if key not in file]
    if missing:
        raise SceneError(f"the dataset '{missing[0]}' is missing; the file holds {_short(sorted(file), str)}")
    states = len(_open_dataset(file, "graph", "iu", (None, 4)))
    if states > MAX_STATES:
        raise SceneError(f"graph: {states} states are more than the {MAX_STATES} this package can hold")
    datasets = _open_datasets(file, states)
    # Where the arrays lie that are memory-mapped, named as in `Scene`: the first byte, the shape and the type of each.
    mapped: dict[str, tuple[int, list[int], str]] = {}
    for array, name in STORED.items():
        if name not in datasets:
            continue
        dataset = datasets[name]
        offset: int | None = dataset.id.get_offset()
        if offset is None:
            raise SceneError(f"{name}: are not stored in one piece (h5repack -f {name}:NONE -l {name}:CONTI does that)")
        if offset + dataset.nbytes > path.stat().st_size:
            raise SceneError(f"{name}: the file ends before they do; it is damaged")
        mapped[array] = (offset, list(dataset.shape), dataset.dtype.str)
    verified = intact or check_digest(file)
    values: NDArray[np.floating] | None = None
    features, extractor = datasets.get("resnet_feature"), "none"
    if features is not None:
        extractor = (
            "; ".join(filter(None, (_text_attribute(features, key) for key in EXTRACTOR_ATTRIBUTES))) or "unknown"
        )
        offset = features.id.get_offset() if verified and features.dtype in (np.float16, np.float32) else None
        if offset is not None:  # mapped like the others: a world copies them, and then they need no memory
            mapped["features"] = (offset, list(features.shape), features.dtype.str)
        else:  # the first crop, a block at a time: float64 takes three times the memory
            kind = np.float16 if features.dtype.itemsize == 2 else np.float32
            values = np.empty((states, features.shape[-1]), kind)
            for rows in blocks(features):
                values[rows] = features[rows, 0] if features.ndim == 3 else features[rows]
    views = datasets.get("observation_webp", datasets.get("observation"))
    return {
        "graph": _in_our_order(datasets["graph"][:], file.attrs.get("actions")),
        "positions": datasets["location"][:],
        "headings": datasets["rotation"][:],
        "features": values,
        "extractor": extractor,
        "name": _text_attribute(file, "name"),
        "source": _text_attribute(file, "source"),
        "goals": _goals(file.attrs.get("goals"), states),
        "mapped": mapped,
        **({} if views is None else _locate_views(views, path, decoded=verified)),
    }


def _open_datasets(file: h5py.File, states: int) -> dict[str, h5py.Dataset]:
    """Return the datasets of a dump by name. Types, shapes and sizes are checked, and that all values were written.

    No value is read. How they are packed is not looked at: what takes too much memory or time ends the process that
    reads them.
    """
    expected: dict[str, tuple[Any, ...]] = {  # kinds of values, and shapes
        "graph": ("iu", (states, 4)),
        "location": ("iuf", (states, 2)),
        "rotation": ("iuf", (states,)),
        "resnet_feature": ("f", (states, None), (states, None, None)),
        "observation_webp": ("O", (states,)),
        "observation": ("u", (states, None, None, 3)),
        "patches": ("f", (states, None, None)),
        "look_feature": ("f", (None, states, None)),
        "look_patches": ("f", (None, states, None, None)),
        "along_feature": ("f", (states, None)),
        "toward": ("f", (2, states, states)),
        "shortest_path_distance": ("iuf", (states, states)),  # never used, but the digest is over it
    }
    datasets = {name: _open_dataset(file, name, *own) for name, own in expected.items() if name in file}
    if "resnet_feature" in datasets:
        shape = datasets["resnet_feature"].shape
        reversed_ = len(shape) == 3 and shape[1] > shape[2]
        if 0 in shape or states * shape[-1] > MAX_FEATURE_VALUES or reversed_:
            raise SceneError(
                "resnet_feature: expected shape (states, features) or (states, crops, features), fewer crops than "
                f"features and {MAX_FEATURE_VALUES} features of all states at most, found {shape}"
            )
    for name in [name for name in STORED.values() if name in datasets]:
        kind, shape = datasets[name].dtype, datasets[name].shape
        if kind != np.float16 or 0 in shape or math.prod(shape) > MAX_VALUES:
            raise SceneError(f"{name}: expected float16 values, at most {MAX_VALUES} of them, found {kind} {shape}")
    if "look_patches" in datasets and "look_feature" not in datasets:
        raise SceneError("look_patches: there is no look_feature; looks have features, and patches if the file has any")
    if "observation_webp" in datasets and h5py.check_vlen_dtype(datasets["observation_webp"].dtype) != np.uint8:
        raise SceneError("observation_webp: expected byte strings (variable-length uint8)")
    if "observation" in datasets:
        kind, shape = datasets["observation"].dtype, datasets["observation"].shape
        if kind != np.uint8 or not 0 < shape[1] * shape[2] <= MAX_PIXELS:
            raise SceneError(f"observation: expected uint8, 1 to {MAX_PIXELS} pixels a view, found {kind} {shape}")
    for name, dataset in datasets.items():
        if dataset.chunks:
            count = math.prod(-(-length // chunk) for length, chunk in zip(dataset.shape, dataset.chunks, strict=True))
            complete = dataset.id.get_num_chunks() >= count
        else:
            complete = dataset.id.get_storage_size() > 0 or not dataset.size
        if not complete:
            raise SceneError(f"{name}: some of its values were never written; was its making stopped?")
    return datasets


def _goals(declared: object, states: int) -> list[int]:
    goals = np.asarray(() if declared is None else declared)
    if goals.size == 0:
        return []
    if goals.dtype.kind not in "iu" or goals.ndim > 1:
        raise SceneError(f"attribute 'goals': expected a list of states (integers), found {_short(declared)}")
    named = np.atleast_1d(goals)
    if len(named) > states:
        raise SceneError(f"attribute 'goals': names {len(named)} goals of {states} states")
    values, counts = np.unique(named, return_counts=True)
    if (counts > 1).any():
        raise SceneError(f"attribute 'goals': names state {values[counts > 1][0]} twice")
    return named.tolist()


def _in_our_order(graph: np.ndarray, declared: object) -> np.ndarray:
    if declared is None:
        return graph
    named = np.atleast_1d(np.asarray(declared)).tolist()
    actions = [name.decode(errors="replace") if isinstance(name, bytes) else str(name) for name in named]
    if sorted(actions) != sorted(ACTIONS):
        raise SceneError(
            f"attribute 'actions': expected {list(ACTIONS)} in the order of graph's columns, found "
            f"{_short(actions) if len(actions) > 5 else actions}"
        )
    return graph[:, [actions.index(action) for action in ACTIONS]]


def _text_attribute(holder: h5py.File | h5py.Dataset, name: str) -> str:
    """Return a text, empty if there is none."""
    value = holder.attrs.get(name, "")
    text = value.decode(errors="replace") if isinstance(value, bytes) else value
    if not isinstance(text, str) or "\ufffd" in text:
        raise SceneError(f"attribute '{name}': expected text, found {_short(value)}")
    if not text.isprintable() or len(text) > MAX_TEXT:
        raise SceneError(f"attribute '{name}': expected one line of text, found {_short(text)}")
    return str(text)


def _open_dataset(file: h5py.File, name: str, kinds: str, *shapes: tuple[int | None, ...]) -> h5py.Dataset:
    """Return a dataset of the file itself whose type and shape are as expected; its values are not read."""
    if not isinstance(file.get(name, getlink=True), h5py.HardLink):
        raise SceneError(f"{name}: is a link to elsewhere; a dump must hold its own data")
    dataset = file[name]
    if not isinstance(dataset, h5py.Dataset):
        raise SceneError(f"{name}: is a {type(dataset).__name__.lower()}; expected a dataset")
    if dataset.is_virtual or dataset.external:
        raise SceneError(f"{name}: its data lies in other files; a dump must hold its own data")
    if dataset.dtype.kind not in kinds:
        wanted = " or ".join(KINDS[kind] for kind in kinds)
        raise SceneError(f"{name}: expected {wanted} values, found {_short(dataset.dtype, str)}")
    actual = dataset.shape or ()
    alike = [shape for shape in shapes if len(shape) == len(actual)]
    if not any(all(w in (None, f) for w, f in zip(shape, actual, strict=True)) for shape in alike):
        expected = [", ".join("any" if size is None else str(size) for size in shape) for shape in shapes]
        raise SceneError(f"{name}: expected shape ({') or ('.join(expected)}), found {actual}")
    return dataset


def _short(value: object, show: Callable[[object], str] = repr) -> str:
    """Return a value of a file for a message, on one line, as Python's own type where it is NumPy's."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    text = " ".join(show(value).split())
    return text if len(text) <= 60 else f"{text[:60]}..."


def _locate_views(dataset: h5py.Dataset, path: Path, *, decoded: bool) -> Contents:
    """Return the arguments of `dirl.scenes.views.Views`, with ``view_`` before their names; each view is decoded once.

    ``decoded`` says that it is known that they can be.
    """
    name = dataset.name.removeprefix("/")
    if dataset.dtype.kind == "O":
        return {"view_dataset": name, "view_spans": _find_values(dataset, path, decoded=decoded)}
    start, size = dataset.id.get_offset(), dataset.nbytes // len(dataset)
    unpacked: NDArray[np.uint8] | None = None
    if start is None:  # in chunks
        if dataset.nbytes > MAX_UNPACKED_VIEWS:
            raise SceneError(
                f"observation: {dataset.nbytes} bytes of raw views in chunks; more than {MAX_UNPACKED_VIEWS} must be "
                "stored in one piece (h5repack -l observation:CONTI)"
            )
        start, unpacked = 0, dataset[:]
    spans = np.stack([start + size * np.arange(len(dataset)), np.full(len(dataset), size)], 1)
    return {"view_dataset": name, "view_spans": spans, "view_shape": dataset.shape[1:3], "view_unpacked": unpacked}


def _find_values(dataset: h5py.Dataset, path: Path, *, decoded: bool) -> IntArray:
    """Return the first byte and the length in the file of each encoded view, int64 ``[N, 2]``.

    libhdf5 does not tell where it finds them: each is looked for where it writes the next value of a collection, then
    behind all, then everywhere.
    """
    name, spans = dataset.name.removeprefix("/"), np.zeros((len(dataset), 2), np.int64)
    expected: deque[int] = deque([0], maxlen=COLLECTIONS)
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
        for first in range(0, len(dataset), AT_A_TIME):
            for state, values in enumerate(dataset[first : first + AT_A_TIME], first):
                value = values.tobytes()
                start = next((at for at in expected if content[at : at + len(value)] == value), -1)
                if start >= 0:
                    expected.remove(start)
                else:
                    start = content.find(value, max(expected))
                if start < 0:
                    start = content.find(value)
                if start < 0:
                    raise SceneError(f"{name}: state {state}: is not stored in one piece")
                if not decoded:
                    check_view(value, f"{name}: state {state}:")
                spans[state] = start, len(value)
                expected.appendleft(start + (len(value) + 7) // 8 * 8 + 16)
    return spans


def check_view(data: bytes, where: str) -> None:
    """Raise `SceneError` unless an encoded view can be decoded."""
    try:
        decode(data)
    except ImageError as error:
        raise SceneError(f"{where} not a readable image ({error})") from None


def write_digest(file: h5py.File) -> None:
    """Store the digest of a file that is otherwise complete."""
    file.attrs[DIGEST] = file["graph"].attrs[DIGEST] = compute_digest(file)


def check_digest(file: h5py.File) -> bool:
    """Compare a file with its digest, `SceneError` if they differ; False if it has none, as other programs' have."""
    stored = [holder.attrs.get(DIGEST) for holder in (file, file["graph"])]
    if stored == [None, None]:
        return False
    digest = compute_digest(file)
    if any(not isinstance(own, str) or own != digest for own in stored):
        raise SceneError(
            "does not hold what was written to it: it is damaged, or was changed without dirl (then delete the "
            f"attribute '{DIGEST}' of the file and of graph)"
        )
    return True


def compute_digest(file: h5py.File) -> str:
    """Return the SHA-256 over the datasets and attributes of a dump that are read, as hexadecimal digits.

    It covers the names, types, shapes and values of `DATASETS`, the file's attributes `FILE_ATTRIBUTES`, the
    `EXTRACTOR_ATTRIBUTES` of the features and the `PATCH_ATTRIBUTES` of patches; not how HDF5 stores them.
    """
    digest = hashlib.sha256()
    digest.update(_attributes(file, FILE_ATTRIBUTES))
    for name in DATASETS:
        if name not in file:
            continue
        dataset = file[name]
        digest.update(json.dumps([name, dataset.dtype.str, dataset.shape]).encode())
        digest.update(_attributes(dataset, PATCH_ATTRIBUTES if name == "patches" else EXTRACTOR_ATTRIBUTES))
        for rows in blocks(dataset):
            values = dataset[rows]
            for part in values if dataset.dtype.kind == "O" else [values]:
                digest.update(part.nbytes.to_bytes(8, "little"))
                digest.update(np.ascontiguousarray(part).data)
    return digest.hexdigest()


def blocks(dataset: h5py.Dataset) -> Iterator[slice]:
    """Yield slices of a dataset's rows to read one after the other: of `BLOCK_BYTES`, or of a row of chunks."""
    row_bytes = max(1, dataset.dtype.itemsize * math.prod(dataset.shape[1:]))
    step = max(1, BLOCK_BYTES // row_bytes)
    if dataset.chunks is not None:  # a chunk that two blocks share would be unpacked twice
        step = max(step // dataset.chunks[0], 1) * dataset.chunks[0]
    for start in range(0, len(dataset), step):
        yield slice(start, min(start + step, len(dataset)))


def _attributes(holder: h5py.File | h5py.Dataset, names: tuple[str, ...]) -> bytes:
    values = {name: np.asarray(holder.attrs[name]).tolist() for name in names if name in holder.attrs}
    return repr(values).encode("utf-8", "surrogateescape")
