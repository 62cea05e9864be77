"""Recordings of robots: HDF5 files whose images have axes for place, heading and shot.

`unpack_recording` writes one as a folder of photographs with its table, which `dirl.sources.photos` reads: what the
recording does not tell, as walls between two places, can be corrected there.
"""

import math
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from typing import NamedTuple

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
    folder, unfinished = Path(folder), Path(f"{folder}.unfinished")
    _check_axes(axes, positions)
    if not Path(file).is_file():  # h5py would wait for a pipe
        raise SceneError(f"{file}: there is no such file")
    with _reading(file):
        recording = h5py.File(file, rdcc_nbytes=MAX_CHUNK_BYTES)  # of a chunk the images are read one by one
    with recording:
        with _reading(file):
            dataset = _images(recording, images, len(axes))
        sizes = dict(zip(axes, dataset.shape, strict=False))
        headings, shots = sizes["heading"], sizes.get("shot", 1)
        if headings % 4:
            raise SceneError(f"{images}: {headings} headings; expected a multiple of four, evenly spread")
        with _reading(file):
            places = _places(recording, positions, sizes, step or 1.0)
        turn = 360 / headings if clockwise else -360 / headings
        angles = [(first_heading + turn * number) % 360 for number in range(headings)]
        shutil.rmtree(unfinished, ignore_errors=True)
        unfinished.mkdir(parents=True)
        try:
            bar = tqdm(places, unit=" places")
            recorded = [place for place in bar if _write_images(dataset, axes, place, unfinished)]
            if len(recorded) < 2:
                raise SceneError(f"{images}: pictures of {len(recorded)} places; at least two are needed")
            write_table(unfinished, _rows(recorded, angles, step or _smallest_distance(recorded), shots))
            unfinished.rename(folder)
        finally:
            shutil.rmtree(unfinished, ignore_errors=True)
        height, width = dataset.shape[-3:-1]
    return f"{folder}: {len(recorded)} places, {headings} headings, shots of a place: {shots}, images {width}x{height}"


def _check_axes(axes: Sequence[str], positions: str | None) -> None:
    if any(axis not in AXES for axis in axes) or len(set(axes)) != len(axes):
        raise SceneError(f"axes={list(axes)}: expected each once, of {', '.join(AXES)}")
    if "heading" not in axes or {"place", "x", "z"} & set(axes) not in ({"place"}, {"x", "z"}):
        raise SceneError(f"axes={list(axes)}: expected heading, and place or x and z")
    if ("place" in axes) != (positions is not None):
        raise SceneError("positions: name the dataset of x and z where axes has place, and only there")


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


class Place(NamedTuple):
    """Where a camera stood."""

    number: dict[str, int]
    """In the axes of the images."""
    x: float
    z: float

    @property
    def name(self) -> str:
        """For the table."""
        return "_".join(map(str, self.number.values()))


def _places(recording: h5py.File, positions: str | None, sizes: Mapping[str, int], step: float) -> list[Place]:
    """All places of the axes: at the positions of a dataset, or on a grid."""
    if positions is None:
        grid = product(range(sizes["x"]), range(sizes["z"]))
        return [Place({"x": column, "z": row}, column * step, row * step) for column, row in grid]
    if positions not in recording:
        raise SceneError(f"positions: {recording.filename} has no dataset '{positions}'")
    dataset = open_dataset(recording, positions, kinds="fiu", shape=(sizes["place"], 2))
    check_storage(dataset)
    values = dataset[()].astype(float)
    if not (np.abs(values) <= LARGEST).all():
        raise SceneError(f"{positions}: holds values that are not finite, or above {LARGEST:g} metres")
    return [Place({"place": number}, x, z) for number, (x, z) in enumerate(values.tolist())]


def _write_images(dataset: h5py.Dataset, axes: Sequence[str], place: Place, folder: Path) -> bool:
    """Write the images of a place; False if it has none, all of them being black."""
    sizes = dict(zip(axes, dataset.shape, strict=False))
    wanted = [*product(range(sizes["heading"]), range(sizes.get("shot", 1)))]

    def read(heading: int, shot: int) -> NDArray[np.uint8]:
        number = {**place.number, "heading": heading, "shot": shot}
        with _reading(dataset.file.filename):
            return np.asarray(dataset[tuple(number[axis] for axis in axes)])

    if not any(read(heading, shot).any() for heading, shot in wanted):
        return False
    for heading, shot in wanted:
        (folder / _image(place, heading, shot)).write_bytes(encode(read(heading, shot), quality=90))
    return True


def _image(place: Place, heading: int, shot: int) -> str:
    return f"{place.name}_heading{heading}_shot{shot}.webp"


def _smallest_distance(places: Sequence[Place]) -> float:
    """Between two places, metres."""
    at = np.unique([(place.x, place.z) for place in places], axis=0)
    if len(at) < 2:
        raise SceneError("positions: there are fewer than two places")
    return float(KDTree(at).query(at, k=2)[0][:, 1].min())


def _rows(places: Sequence[Place], angles: Sequence[float], step: float, shots: int) -> list[dict[str, object]]:
    """The rows of ``states.csv``, of the first shot with moves."""
    at = np.array([(place.x, place.z) for place in places]).reshape(-1, 2)
    rows: list[dict[str, object]] = []
    for place, (heading, angle), shot in product(places, enumerate(angles), range(shots)):
        row: dict[str, object] = {"image": _image(place, heading, shot), "location": place.name, "heading": angle}
        row |= {"x": place.x, "z": place.z, "shot": shot or ""}
        if not shot:
            ahead = step * np.array([math.sin(math.radians(angle)), math.cos(math.radians(angle))])
            for name, move in (("ahead", ahead), ("back", -ahead)):
                off = np.linalg.norm(at - (place.x, place.z) - move, axis=1)
                row[name] = places[int(off.argmin())].name if off.min() <= NEAR * step else ""
        rows.append(row)
    return rows
