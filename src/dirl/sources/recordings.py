"""Recordings of robots: HDF5 files whose images have axes for place, heading and shot.

`unpack_recording` writes one as a folder of photographs with its table, which `dirl.sources.photos` reads: what the
recording does not tell, as walls between two places, can be corrected there.
"""

import math
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import product
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from tqdm import tqdm

from dirl.scenes.io.datasets import MAX_CHUNK_BYTES, check_storage, open_dataset
from dirl.scenes.io.hdf5 import MAX_STATES, unreadable
from dirl.scenes.scene import LARGEST, SceneError
from dirl.scenes.views import MAX_PIXELS, encode
from dirl.sources.photos import write_table

AXES = ("place", "x", "z", "heading", "shot")

NEAR = 0.3
"""How far from where a step leads the next place may be, in steps."""


def unpack_recording(
    file: str | Path,
    folder: str | Path,
    *,
    images: str,
    axes: Sequence[str],
    positions: str | None = None,
    step: float | None = None,
    first_heading: float = 0.0,
    clockwise: bool = True,
) -> str:
    """Write a recording as a folder that ``photos`` reads: WebP images and ``states.csv``, completely or not at all.

    A move ahead leads to the place that is a step away in the direction of the heading. Places without any picture
    (all of it zero) were not recorded, and are left out.

    Args:
        file: HDF5.
        folder: a new one.
        images: its dataset, uint8 ``[*axes, H, W, 3]``.
        axes: what its first axes are, of `AXES`: ``heading``, and ``place`` or ``x`` and ``z``; ``shot`` if there is
            more than one picture of a place and heading.
        positions: of the axis ``place``, the dataset of its positions x and z, numbers ``[P, 2]``, metres.
        step: metres between two places next to each other; None is the smallest distance, or 1 for axes x and z.
        first_heading: degrees clockwise from z, of the first one; the others follow evenly.
        clockwise: whether the headings do.

    Returns:
        What was written, in one line.

    Raises:
        SceneError: the file or the options cannot be used; names the dataset.
        OSError: something cannot be read or written.
    """
    if any(axis not in AXES for axis in axes) or len(set(axes)) != len(axes):
        raise SceneError(f"axes={list(axes)}: expected each once, of {', '.join(AXES)}")
    of_place = [axis for axis in ("place", "x", "z") if axis in axes]
    if "heading" not in axes or of_place not in (["place"], ["x", "z"]):
        raise SceneError(f"axes={list(axes)}: expected heading, and place or x and z")
    if ("place" in axes) != (positions is not None):
        raise SceneError("positions: name the dataset of x and z where axes has place, and only there")
    if not Path(file).is_file():  # h5py would wait for a pipe
        raise SceneError(f"{file}: there is no such file")
    folder, unfinished = Path(folder), Path(f"{folder}.unfinished")
    with _reading(file):
        recording = h5py.File(file, rdcc_nbytes=MAX_CHUNK_BYTES)  # of a chunk the images are read one by one
    with recording:
        with _reading(file):
            dataset = _images(recording, images, len(axes))
            sizes = dict(zip(axes, dataset.shape, strict=False))
            headings, shots = sizes["heading"], sizes.get("shot", 1)
            if headings % 4:
                raise SceneError(f"{images}: {headings} headings; expected a multiple of four, evenly spread")
            numbers = list(np.ndindex(*(sizes[axis] for axis in of_place)))
            given = np.array(numbers) * (step or 1.0)
            at = given if positions is None else _positions(recording, positions, len(numbers))

        def read(place: tuple[int, ...], heading: int, shot: int) -> NDArray[np.uint8]:
            number = {**dict(zip(of_place, place, strict=True)), "heading": heading, "shot": shot}
            with _reading(file):
                return np.asarray(dataset[tuple(number[axis] for axis in axes)])

        shutil.rmtree(unfinished, ignore_errors=True)
        unfinished.mkdir(parents=True)
        try:
            recorded = []
            for index, place in enumerate(tqdm(numbers, unit=" places")):
                taken = [*product(range(headings), range(shots))]
                if not any(read(place, *one).any() for one in taken):
                    continue  # all black
                recorded.append(index)
                for one in taken:
                    (unfinished / _image(place, *one)).write_bytes(encode(read(place, *one), quality=90))
            if len(recorded) < 2:
                raise SceneError(f"{images}: pictures of {len(recorded)} places; at least two are needed")
            turn = 360 / headings if clockwise else -360 / headings
            angles = [(first_heading + turn * number) % 360 for number in range(headings)]
            kept = [numbers[index] for index in recorded]
            write_table(unfinished, _rows(kept, at[recorded], angles, step or _smallest_distance(at[recorded]), shots))
            unfinished.rename(folder)
        finally:
            shutil.rmtree(unfinished, ignore_errors=True)
        height, width = dataset.shape[-3:-1]
    return f"{folder}: {len(recorded)} places, {headings} headings, shots of a place: {shots}, images {width}x{height}"


@contextmanager
def _reading(file: str | Path) -> Iterator[None]:
    """Within this context whatever h5py raises for a damaged file is one line."""
    try:
        yield
    except SceneError:
        raise
    except Exception as error:
        raise SceneError(f"{file}: {unreadable(error)}") from None


def _images(recording: h5py.File, name: str, axes: int) -> h5py.Dataset:
    if name not in recording:
        raise SceneError(f"{recording.filename}: there is no dataset '{name}'; it has {', '.join(recording) or 'none'}")
    dataset = open_dataset(recording, name, kinds="u", shape=(*([None] * (axes + 2)), 3))
    if dataset.dtype != np.uint8 or 0 in dataset.shape:
        raise SceneError(f"{name}: expected uint8 images, found {dataset.dtype} {dataset.shape}")
    states = math.prod(dataset.shape[:axes])
    if states > MAX_STATES or math.prod(dataset.shape[axes : axes + 2]) > MAX_PIXELS:
        raise SceneError(f"{name}: shape {dataset.shape}: at most {MAX_STATES} images of {MAX_PIXELS} pixels are read")
    check_storage(dataset)
    return dataset


def _positions(recording: h5py.File, name: str, places: int) -> NDArray[np.float64]:
    """Return the positions of all places, metres, float64 ``[P, 2]``."""
    if name not in recording:
        raise SceneError(f"positions: {recording.filename} has no dataset '{name}'")
    dataset = open_dataset(recording, name, kinds="fiu", shape=(places, 2))
    check_storage(dataset)
    values: NDArray[np.float64] = dataset[()].astype(float)
    if not (np.abs(values) <= LARGEST).all():
        raise SceneError(f"{name}: holds values that are not finite, or above {LARGEST:g} metres")
    return values


def _image(place: tuple[int, ...], heading: int, shot: int) -> str:
    return f"{_name(place)}_heading{heading}_shot{shot}.webp"


def _name(place: tuple[int, ...]) -> str:
    return "_".join(map(str, place))


def _smallest_distance(at: NDArray[np.float64]) -> float:
    """Between two places, metres."""
    different = np.unique(at, axis=0)
    if len(different) < 2:
        raise SceneError("positions: there are fewer than two places")
    return float(KDTree(different).query(different, k=2)[0][:, 1].min())


def _rows(
    places: Sequence[tuple[int, ...]], at: NDArray[np.float64], angles: Sequence[float], step: float, shots: int
) -> list[dict[str, object]]:
    """Return the rows of ``states.csv``, of the first shot with moves."""
    rows: list[dict[str, object]] = []
    for index, (heading, angle), shot in product(range(len(places)), enumerate(angles), range(shots)):
        x, z = at[index].tolist()
        row: dict[str, object] = {"image": _image(places[index], heading, shot), "location": _name(places[index])}
        row |= {"heading": angle, "x": x, "z": z, "shot": shot or ""}
        if not shot:
            ahead = step * np.array([math.sin(math.radians(angle)), math.cos(math.radians(angle))])
            for name, move in (("ahead", ahead), ("back", -ahead)):
                off = np.linalg.norm(at - at[index] - move, axis=1)
                row[name] = _name(places[int(off.argmin())]) if off.min() <= NEAR * step else ""
        rows.append(row)
    return rows
