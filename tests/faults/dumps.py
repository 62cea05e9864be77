"""Damage thousands of dumps and read each: nothing may crash, hang, print a traceback or pass changed data as good.

    nice python tests/faults/dumps.py count=10000 seed=7

Each file is damaged in one of `WAYS` and read in a process that is forked from one that has everything imported. What
crashes or hangs there is read once more as a user reads it, by `read_dump`; so is every fiftieth file. The same seed
damages the same files. The exit status is 1 if a file was not read as it should be; those are listed.

What is well stored and makes no sense, as another type, shape or value, is in tests/scenes/io/test_malformed_dumps.py.
"""

import gc
import hashlib
import signal
import tempfile
import warnings
from contextlib import suppress
from functools import partial
from pathlib import Path
from unittest.mock import patch

import h5py
import numpy as np
from campaign import conclude, in_a_fork, start
from rooms import grid_scene, published_dump, read_here

from dirl.scenes import SceneError, read_dump, write_dump
from dirl.scenes.io import read as isolation
from dirl.scenes.views import encode

CPU_SECONDS, MEMORY = 1.0, 8 * 2**30
READ_APART = 50
"""Every so many are read as a user's are as well."""

SAME, CHANGED, LINE = "read, and as it was", "read, and changed", "refused with one line"
CRASHED, SLOW = "refused with one line: libhdf5 crashed", "refused with one line: out of time"
SILENT, TRACEBACK, LOST = "CHANGED IN SPITE OF A DIGEST", "TRACEBACK", "NO LINE FROM read_dump"
FAILURES = (SILENT, TRACEBACK, LOST)


def flip_bits(path, rng, start=0, stop=None):
    """Flip up to four bits between two places of the file."""
    content = bytearray(path.read_bytes())
    stop = min(stop or len(content), len(content))
    for _ in range(rng.integers(1, 5)):
        content[int(rng.integers(max(start, 0), stop))] ^= 1 << rng.integers(8)
    path.write_bytes(content)


def anywhere(rng, path):
    flip_bits(path, rng)


def in_the_metadata(rng, path):
    """Where HDF5 keeps its tables: around the signatures of its structures."""
    content = path.read_bytes()
    signs = [b"\x89HDF", b"TREE", b"HEAP", b"SNOD", b"GCOL", b"graph", b"digest", b"name", b"goals"]
    at = int(rng.choice([at for sign in signs if (at := content.find(sign)) >= 0]))
    flip_bits(path, rng, at - 64, at + 512)


def in_a_header(rng, path):
    """The header of one dataset: its type, shape, storage and attributes."""
    with h5py.File(path) as file:
        start = h5py.h5o.get_info(file[str(rng.choice(list(file)))].id).addr
    flip_bits(path, rng, start, start + 300)


def overwrite(rng, path):
    """Up to 512 bytes with noise or with one value; or they are lost, or all to the end."""
    content = bytearray(path.read_bytes())
    at, length = int(rng.integers(len(content))), int(rng.choice([rng.integers(1, 65), 512]))
    other = [rng.bytes(length), bytes([rng.choice([0, 255])]) * length, b"", b""][rng.integers(4)]
    content[at : at + length if other or rng.random() < 0.5 else None] = other
    path.write_bytes(content)


def break_a_chunk(rng, path):
    """Noise in the place of the chunk that the filters of a dataset expect, often shorter than that."""
    filters = [{"compression": "gzip"}, {"shuffle": True, "fletcher32": True}, {"compression": "lzf"}]
    with h5py.File(path, "a") as file:
        name = str(rng.choice([name for name in file if file[name].dtype.kind != "O"]))
        values = file[name][:]
        del file[name]
        dataset = file.create_dataset(name, data=values, chunks=values.shape, **filters[rng.integers(3)])
        length = int(rng.integers(1, 40)) if rng.random() < 0.5 else values.nbytes
        dataset.id.write_direct_chunk((0,) * values.ndim, rng.bytes(length), int(rng.integers(4)))


def change_a_view(rng, path):
    with h5py.File(path, "a") as file:
        if "observation_webp" not in file:
            file["observation"][rng.integers(24)] += 1
            return
        state = int(rng.integers(24))
        view = bytearray(file["observation_webp"][state].tobytes())
        if rng.random() < 0.5:
            view = view[: rng.integers(len(view))]
        else:
            view[rng.integers(len(view))] ^= 1 << rng.integers(8)
        file["observation_webp"][state] = np.frombuffer(bytes(view) or b"%!PS", np.uint8)


WAYS = (anywhere, in_the_metadata, in_a_header, overwrite, break_a_chunk, change_a_view)
"""Each is given a generator of random numbers and the path of a good file, and changes it."""


def bases(folder):
    """Good files by what they are: with the bytes, and whether a digest protects them."""
    rng = np.random.default_rng(0)
    scene = grid_scene(name="hall", goals=(3, 17))
    views = [encode(rng.integers(0, 256, (12, 16, 3), np.uint8)) for _ in range(24)]
    write_dump(folder / "ours.h5", scene, views, feature_attributes={"extractor": "ResNet-50", "weights": "v2"})
    published_dump(folder / "published.h5", scene, crops=2)
    (folder / "unsigned.h5").write_bytes((folder / "ours.h5").read_bytes())
    with h5py.File(folder / "unsigned.h5", "a") as file:
        del file.attrs["digest"], file["graph"].attrs["digest"]
    return {name: (folder / f"{name}.h5").read_bytes() for name in ("ours", "unsigned", "published")}


def fingerprint(scene):
    """A digest of everything that a scene holds, its views decoded."""
    digest = hashlib.sha256(repr((scene.name, scene.source, scene.extractor, scene.goals)).encode())
    for array in (scene.graph, scene.positions, scene.headings, scene.features):
        digest.update(repr(None if array is None else (array.shape, array.dtype)).encode())
        digest.update(b"" if array is None else array.tobytes())
    for state in range(len(scene) if scene.views else 0):
        view = scene.views[state]
        digest.update(repr(view.shape).encode() + view.tobytes())
    return digest.hexdigest()


def outcome(path, good, protected, *, isolated):
    """What came of reading a file, in this process."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found = fingerprint(read_dump(path) if isolated else read_here(path))
    except SceneError as error:
        return LINE if "\n" not in str(error) and str(error).startswith(f"{path}: ") else TRACEBACK
    except Exception:
        return TRACEBACK
    return SAME if found == good else SILENT if protected else CHANGED


def in_a_limited_fork(read):
    """The outcome that a function gives in a fork with little time and memory."""

    def say():
        signal.setitimer(signal.ITIMER_PROF, CPU_SECONDS)  # its signal ends the process
        yield read()

    found, ended, _ = in_a_fork(say, MEMORY)
    return found[0] if found else SLOW if ended == signal.SIGPROF else CRASHED


def damage(path, content, way, seed):
    """Write a damaged file; what HDF5 itself refuses to write is left as far as it came."""
    path.write_bytes(content)
    with suppress(Exception):
        way(np.random.default_rng(seed), path)


def try_files(numbers, seed, folder):
    """Damage and read files; yields the base, the outcome, the way and the number of each."""
    files, goods, path = bases(folder), {}, folder / "room.h5"  # a file without a name is called by its stem
    for base, content in files.items():
        path.write_bytes(content)
        goods[base] = fingerprint(read_dump(path))
    gc.freeze()  # what is not looked at is not copied in a fork

    def choose(number):
        rng = np.random.default_rng((seed, number))
        return str(rng.choice(list(files))), WAYS[rng.integers(len(WAYS))]

    def read(number, *, isolated=False):
        base, way = choose(number)
        damage(path, files[base], way, (seed, number, 1))
        return outcome(path, goods[base], base == "ours", isolated=isolated)

    for number in numbers:
        found = in_a_limited_fork(partial(read, number))
        if found in (CRASHED, SLOW):
            found = found if read(number, isolated=True) == LINE else LOST
        elif number % READ_APART == 0 and read(number, isolated=True) != found:
            found = LOST
        base, way = choose(number)
        yield base, found, way.__name__, number


def main(count=1000, seed=0):
    """Try ``count`` files; how many went wrong."""
    patch.stopall()  # in the test suite this process comes from one that reads dumps itself
    isolation.SECONDS, isolation.PATIENCE = CPU_SECONDS, 10_000  # the machine may be as busy as it likes
    with tempfile.TemporaryDirectory() as folder:
        return conclude(try_files(range(count), seed, Path(folder)), FAILURES)


if __name__ == "__main__":
    start(main)
