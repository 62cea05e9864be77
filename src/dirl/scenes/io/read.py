"""Scene dumps: one HDF5 file a scene, in the layout of the published target-driven navigation code and ours.

| dataset | shape | meaning |
|---|---|---|
| ``graph`` | integer ``[N, 4]`` | next state for ahead, right, left, back; -1 = blocked |
| ``location`` | number ``[N, 2]`` | x, z in metres |
| ``rotation`` | number ``[N]`` | heading in degrees |
| ``resnet_feature`` | float16 or float32 ``[N, D]`` or ``[N, k, D]`` | features; of ``k`` crops the first is used |
| ``patches`` | float16 ``[N, cells, channels]`` | features of the parts of each view (our files); contiguous |
| ``look_feature`` | float16 ``[K, N, D]`` | features of K further looks of each state (our files); contiguous |
| ``look_patches`` | float16 ``[K, N, cells, channels]`` | their patches; contiguous |
| ``along_feature`` | float16 ``[N, D]`` | features along each state's arrow (our tours); contiguous |
| ``toward`` | float16 ``[2, N, N]`` | how clearly each arrow leads to each state, see `Scene` (our tours); contiguous |
| ``shortest_path_distance`` | number ``[N, N]`` | ignored: distances are always recomputed |
| ``observation`` | uint8 ``[N, H, W, 3]`` | raw views (published files) |
| ``observation_webp`` | N byte strings | encoded views (our files): WebP, PNG or JPEG |

``graph``, ``location`` and ``rotation`` are required. File attributes, all optional: ``name``, ``source``, ``goals``
and ``actions`` (the order of the columns of ``graph``, if not the one above). Attributes of ``resnet_feature``:
``extractor``, ``preprocessing``, ``weights``; of ``patches``: ``extractor``, ``projection``. Attribute ``digest`` of
the file and of ``graph``, which all files that dirl writes have: a SHA-256 over all of these; a file that differs from
it is refused.
"""

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dirl.scenes.io.atomic import file_digest
from dirl.scenes.io.hdf5 import Contents, read_contents
from dirl.scenes.io.isolation import read_apart
from dirl.scenes.scene import Scene, SceneError, check_name
from dirl.scenes.views import FileViews

ROOMS = Path(__file__).parents[1] / "data"
"""The built-in rooms: synthetic, with the names, state counts and goals of the published scenes."""

SUMS = "9a70f98597b4e964880ff6ac12210c4a228949e0dbc630e089535eba6dd04a46"
"""The SHA-256 of ``SHA256SUMS``, the list of their hashes."""


@dataclass(frozen=True)
class Dump:
    """A file to be read; see `read_dump`."""

    path: Path
    name: str | None = None
    source: str | None = None


def read_dump(path: str | Path, *, name: str | None = None, source: str | None = None, isolated: bool = True) -> Scene:
    """Read and check one scene.

    Args:
        path: the HDF5 file.
        name: of the scene; the file's attribute ``name`` or its stem if left out.
        source: its origin; the file's attribute ``source`` or "unlabelled" if left out.
        isolated: read the file in a separate process, with limits of time and memory, because libhdf5 can crash or
            hang on a damaged one. A built-in room with the right checksum is always read in this process.

    Raises:
        SceneError: the file is missing, damaged or invalid. The message names the file,
            the dataset, and the first offending state.
    """
    return read_dumps([Dump(Path(path), name, source)], isolated=isolated)[0]


def read_dumps(dumps: Sequence[Dump], *, isolated: bool = True) -> list[Scene]:
    """Read several scenes, see `read_dump`; one process serves all that are to be isolated."""
    for dump in dumps:
        if not dump.path.is_file():
            raise SceneError(f"{dump.path}: there is no such file")
    intact = [_is_intact_room(dump.path) for dump in dumps]
    unknown = [dump.path.absolute() for dump, known in zip(dumps, intact, strict=True) if not known]
    apart = read_apart(unknown) if isolated and unknown else map(read_contents, unknown)
    scenes = []
    for dump, known in zip(dumps, intact, strict=True):
        try:
            contents = read_contents(dump.path, intact=True) if known else next(apart)
        except SceneError as error:
            raise SceneError(f"{dump.path}: {error}") from None
        scenes.append(_scene(dump, contents, intact=known))
    return scenes


def _scene(dump: Dump, contents: Contents, *, intact: bool) -> Scene:
    # A file may have any name; that of a scene stands in paths, in pictures and on command lines.
    name = dump.name or contents["name"] or re.sub(r"[^\w .,()+-]+", "_", dump.path.stem).strip("_ .,(+-") or "scene"
    check_name(name, str(dump.path))
    views = {key.removeprefix("view_"): contents.pop(key) for key in [*contents] if key.startswith("view_")}
    mapped: dict[str, np.ndarray] = {
        array: np.memmap(dump.path, dtype, "r", offset, tuple(shape))
        for array, (offset, shape, dtype) in contents.pop("mapped").items()
    }
    if "features" in mapped and mapped["features"].ndim == 3:
        mapped["features"] = mapped["features"][:, 0]  # the first crop
    beside = dump.path.with_suffix(".patches.npy")
    if intact and "patches" not in mapped and beside.is_file() and _is_intact_room(beside):
        mapped["patches"] = np.load(beside, mmap_mode="r", allow_pickle=False)
    about: Contents = {
        "name": name,
        "source": dump.source or contents["source"] or "unlabelled",
        "goals": tuple(contents["goals"]),
        "origin": str(dump.path),
    }
    return Scene(views=FileViews(dump.path.resolve(), **views) if views else None, **{**contents, **mapped, **about})


def _is_intact_room(path: Path) -> bool:
    """True if a file is one of the built-in rooms; `SceneError` if it is, but not as it was installed."""
    sums = ROOMS / "SHA256SUMS"
    if path.resolve().parent != ROOMS.resolve() or not sums.is_file():
        return False
    content = sums.read_bytes()
    if hashlib.sha256(content).hexdigest() != SUMS:
        raise SceneError(f"{sums}: is not the list of hashes that was installed; install dirl again")
    digests = {name: digest for digest, name in map(str.split, content.decode().splitlines())}
    if path.name in digests and file_digest(path) != digests[path.name]:
        raise SceneError(f"{path}: is not the built-in room that was installed (SHA-256 differs); install dirl again")
    return path.name in digests
