"""Digests of dumps and of folders that dirl writes, by which later damage is detected."""

import hashlib
import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path

import h5py
import numpy as np

from dirl.scenes.scene import SceneError

DATASETS = (
    "graph",
    "location",
    "rotation",
    "resnet_feature",
    "patches",
    "look_feature",
    "look_patches",
    "along_feature",
    "shortest_path_distance",
    "observation",
    "observation_webp",
)

FILE_ATTRIBUTES = ("name", "source", "goals", "actions")
EXTRACTOR_ATTRIBUTES = ("extractor", "preprocessing", "weights")
PATCH_ATTRIBUTES = ("extractor", "projection")

DIGEST = "digest"
"""The attribute of a dump (``graph`` has it too, for damage can also make attributes disappear), or the key in JSON."""

BLOCK_BYTES = 2**24


def write_digest(file: h5py.File) -> None:
    """Store the digest of a file that is otherwise complete."""
    file.attrs[DIGEST] = file["graph"].attrs[DIGEST] = compute_digest(file)


def check_digest(file: h5py.File) -> bool:
    """Compare a file with its digest, `SceneError` if they differ; False if it has none, as other programs' have."""
    stored = [holder.attrs.get(DIGEST) for holder in (file, file["graph"])]
    if stored == [None, None]:
        return False
    found = compute_digest(file)
    if any(not isinstance(one, str) or one != found for one in stored):
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
    """Slices of a dataset's rows that can be read one after the other: of `BLOCK_BYTES`, or of a row of chunks."""
    row_bytes = max(1, dataset.dtype.itemsize * math.prod(dataset.shape[1:]))
    step = max(1, BLOCK_BYTES // row_bytes)
    if dataset.chunks is not None:  # a chunk that two blocks share would be unpacked twice
        step = max(step // dataset.chunks[0], 1) * dataset.chunks[0]
    for start in range(0, len(dataset), step):
        yield slice(start, min(start + step, len(dataset)))


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a file's bytes, as hexadecimal digits."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _attributes(holder: h5py.File | h5py.Dataset, names: tuple[str, ...]) -> bytes:
    values = {name: np.asarray(holder.attrs[name]).tolist() for name in names if name in holder.attrs}
    return repr(values).encode("utf-8", "surrogateescape")


def sealed(facts: Mapping[str, object], *contents: bytes) -> dict[str, object]:
    """Facts to be written as JSON, with a digest over them and the contents of other files of their folder."""
    digest = hashlib.sha256(json.dumps(facts, sort_keys=True).encode())
    for content in contents:
        digest.update(hashlib.sha256(content).digest())
    return {**facts, DIGEST: digest.hexdigest()}


def check_seal(facts: Mapping[str, object], *contents: bytes) -> None:
    """Check what `sealed` added, ValueError if anything is not as it was written."""
    plain = {key: value for key, value in facts.items() if key != DIGEST}
    if facts != sealed(plain, *contents):
        raise ValueError("its files are not those that were written: the digest differs")
