"""Give every reader small files that declare much: each ends in 60 s of processor time and 2 GB, with one line.

    nice python tests/faults/declared.py [quick | name ...]

Each case writes a file of at most 6 MB and reads it in a fork, as a recipe would. It prints a line for each case: what
came of it, seconds, and how much more memory it took than the process had. The exit status is 1 if a case took more,
ended in a traceback, or in more than one line.
"""

import json
import os
import resource
import signal
import struct
import sys
import tempfile
import zipfile
import zlib
from functools import partial
from pathlib import Path

try:
    from compression import zstd
except ImportError:  # before Python 3.14
    from backports import zstd

import numpy as np
import torch
from campaign import in_a_fork

from dirl.agent.mapping.frames import FrameMap, load_frames_map
from dirl.perception.matching import Described
from dirl.reporting.strips import draw_strip
from dirl.runs.checkpoints import load_checkpoint
from dirl.scenes.io.files import read_tensors
from dirl.sources.photos import encoded_photos, read_photos
from dirl.sources.rooms import read_description
from dirl.sources.tours import read_tour
from dirl.sources.tours.images import cut_views
from dirl.sources.video import Recording, read_photo
from dirl.sources.vizdoom import _check_map

SECONDS, MEMORY = 60, 2.0
"""Of the processor, and gigabytes."""


def png(width, height, colour=0, bits=8):
    """A PNG of zeros of this size: a small file, whatever the size."""
    channels = {0: 1, 2: 3, 6: 4}[colour]
    packer, row, data = zlib.compressobj(1), bytes(1 + (width * channels * bits + 7) // 8), b""
    for _ in range(height):
        data += packer.compress(row)
    parts = [(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0)), (b"IDAT", data + packer.flush())]
    body = b"".join(
        struct.pack(">I", len(part)) + kind + part + struct.pack(">I", zlib.crc32(kind + part))
        for kind, part in [*parts, (b"IEND", b"")]
    )
    return b"\x89PNG\r\n\x1a\n" + body


def tour(name):
    """A case whose tour is written by a function of the folder."""

    def case(write):
        def make(folder):
            (folder / name).write_text(write())
            (folder / "a.jpg").touch()
            return lambda: read_tour(folder)

        return make

    return case


def scenes_of_marzipano(count, **scene):
    text = json.dumps([{"id": f"s{number}", **scene} for number in range(count)])
    return f"var APP_DATA = {{scenes: {text}}};"


def multires():
    scene = {
        "type": "multires",
        "multiRes": {"path": "%l%s%y%x", "cubeResolution": 2**15, "tileResolution": 512, "maxLevel": 16},
    }
    return json.dumps({"scenes": {str(number): scene for number in range(2000)}})


def panorama_of(data, name="a.png"):
    """A case that cuts a view out of a panorama."""

    def make(folder):
        (folder / name).write_bytes(data())
        (folder / "b.png").write_bytes(png(64, 32))
        (folder / "links.csv").write_text(f"image,to,yaw\n{name},b.png,0\nb.png,{name},0\n")

        def read():
            images = [one.image for one in read_tour(folder).panoramas]
            list(cut_views(images, np.zeros((2, 1)), size=(300, 400), field_of_view=90))

        return read

    return make


def cube(side):
    def make(folder):
        (folder / "a.png").write_bytes(png(side, side))
        scene = {"type": "cubemap", "cubeMap": ["a.png"] * 6}
        (folder / "tour.json").write_text(json.dumps({"scenes": {"a": scene}}))
        image = read_tour(folder).panoramas[0].image
        return lambda: list(cut_views([image], np.zeros((1, 1)), size=(300, 400), field_of_view=90))

    return make


def photo(data, read=lambda file: list(encoded_photos([file], 300, 400))):
    def make(folder):
        (folder / "a.png").write_bytes(data())
        return lambda: read(folder / "a.png")

    return make


def webp(width, height):
    """The header of a WebP file that declares a canvas of this size."""
    sides = struct.pack("<I", width - 1)[:3] + struct.pack("<I", height - 1)[:3]
    chunk = b"VP8X" + struct.pack("<I", 10) + bytes(4) + sides
    pixel = b"VP8L" + struct.pack("<I", 14) + bytes.fromhex("2f000000103f1111100a20d2ff88")
    return b"RIFF" + struct.pack("<I", 4 + len(chunk + pixel)) + b"WEBP" + chunk + pixel


def many_headings(folder):
    """A table of 36,000 headings at each of two places."""
    (folder / "a.png").write_bytes(png(16, 12))
    lines = ["image,location,heading,x,z,ahead"]
    for place, x, ahead in (("a", 0, "b"), ("b", 1, "")):
        lines += [f"a.png,{place},{heading / 100},{x},0,{ahead}" for heading in range(36_000)]
    (folder / "states.csv").write_text("\n".join(lines))
    return lambda: read_photos(folder)


def sparse(name, read):
    def make(folder):
        (folder / name).touch()
        os.truncate(folder / name, 2**40)
        return lambda: read(folder)

    return make


def weights(folder):
    torch.save({"a": torch.zeros(1).expand(10**12)}, folder / "a.pt")
    return lambda: read_tensors(folder / "a.pt")["a"].half()


def pipe(name, read):
    def make(folder):
        os.mkfifo(folder / name)
        return lambda: read(folder)

    return make


def wad(folder):
    (folder / "a.wad").write_bytes(struct.pack("<4sii", b"PWAD", 2**31 - 1, 12) + bytes(32))
    return lambda: _check_map(folder / "a.wad", "map01")


def frames_map(folder):
    """5 MB of zeros that unpack to 5.4 GB, as a map has them."""
    with zipfile.ZipFile(folder / "a.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        with archive.open("frames.npy", "w", force_zip64=True) as stream:
            about = {"descr": "|u1", "fortran_order": False, "shape": (60_000, 120, 250, 3)}
            np.lib.format.write_array_header_1_0(stream, about)
            for _ in range(600):
                stream.write(bytes(100 * 120 * 250 * 3))
        for name, value in {"shortcuts": np.zeros((0, 2), np.int64), "field_of_view": np.float64(65)}.items():
            with archive.open(f"{name}.npy", "w") as stream:
                np.lib.format.write_array(stream, np.asarray(value))
    return lambda: load_frames_map(folder / "a.npz")


def pictures_of_a_map(folder):
    """Small files of pictures that are far larger than any in a map."""
    pictures, count = png(2**24, 1), 16
    looks = np.zeros((count, 8), np.float16)
    points = np.zeros((count, 4, 2), np.float16), np.zeros((count, 4, 64), np.int8), np.zeros(count, np.int16)
    views, links = Described(looks, *points), np.zeros((0, 2), np.int64)
    times, parts = np.arange(count, dtype=float), np.zeros(count, np.int64)
    FrameMap([pictures] * count, times, parts, views, links, 65.0, "sift", (8, 8)).save(folder / "a.npz")

    def read():
        graph = load_frames_map(folder / "a.npz")
        draw_strip([(f"{frame}", graph.picture(frame)) for frame in range(count)], folder / "way.png")

    return read


def bag(data):
    """A case of a bag in one file."""

    def make(folder):
        file = folder / f"a.{'mcap' if data is mcap else 'bag'}"
        file.write_bytes(data(2**32))
        return lambda: list(Recording(file))

    return make


def packed(size, packer):
    """So many zeros, compressed."""
    megabyte = bytes(2**20)
    return b"".join([packer.compress(megabyte) for _ in range(size // len(megabyte))] + [packer.flush()])


def mcap(size):
    """A file of MCAP without an index, whose one chunk unpacks to so many zeros."""

    def record(kind, data):
        return bytes([kind]) + struct.pack("<Q", len(data)) + data

    def text(word):
        return struct.pack("<I", len(word)) + word

    chunk = packed(size, zstd.ZstdCompressor())
    about = struct.pack("<QQQI", 0, 10, size, 0) + text(b"zstd") + struct.pack("<Q", len(chunk))
    records = record(1, text(b"ros2") + text(b"")) + record(6, about + chunk)
    end = record(15, struct.pack("<I", 0)) + record(2, struct.pack("<QQI", 0, 0, 0))
    return b"\x89MCAP0\r\n" + records + end + b"\x89MCAP0\r\n"


def description(text):
    def make(folder):
        (folder / "a.toml").write_text(text())
        return lambda: read_description(folder / "a.toml")

    return make


KRPANO = '<krpano><scene name="a"><image><cube url="%s"/></image></scene></krpano>'

CASES = {
    "a data.js of comments": tour("data.js")(lambda: "/**/" * 40 + "function () {}"),
    "a page of a comment without end": tour("index.html")(lambda: 'scenes: v = {"a": ' + "/*" * 500_000),
    "a page of braces": tour("index.html")(lambda: "scenes: {" * 100_000),
    "tiles of one pixel": tour("data.js")(lambda: scenes_of_marzipano(200, levels=[{"size": 64, "tileSize": 1}] * 16)),
    "an address with 300,000 zeros": tour("tour.xml")(lambda: KRPANO % f"%{'0' * 300_000}s.jpg"),
    "5 million elements": tour("tour.xml")(lambda: f"<krpano>{'<a/>' * 1_500_000}</krpano>"),
    "2,000 cubes of 64 tiles a side": tour("tour.json")(multires),
    "a large panorama": panorama_of(lambda: png(28_000, 14_000)),
    "a panorama as large as may be": panorama_of(lambda: png(19_998, 9_999, colour=2)),
    "a face of a cube as large as may be": cube(11_584),
    "a large photograph": photo(lambda: png(16_384, 16_384, colour=6)),
    "a photograph as large as may be": photo(lambda: png(15_000, 13_300, colour=6)),
    "a large canvas of WebP": photo(lambda: webp(16_383, 16_383)),
    "a large photo to go to": photo(lambda: png(16_384, 16_384, colour=6), read_photo),
    "36,000 headings": many_headings,
    "a sparse states.csv": sparse("states.csv", read_photos),
    "a sparse checkpoint": sparse("network.pt", load_checkpoint),
    "weights that repeat a number": weights,
    "a pipe for states.csv": pipe("states.csv", read_photos),
    "a pipe for tour.json": pipe("tour.json", read_tour),
    "a pipe for a room": pipe("a.toml", lambda folder: read_description(folder / "a.toml")),
    "a pipe for a WAD": pipe("a.wad", lambda folder: _check_map(folder / "a.wad", "map01")),
    "a pipe for a video": pipe("a.mp4", lambda folder: Recording(folder / "a.mp4")),
    "functions without end": tour("index.html")(lambda: "scenes: {" + ":function(){:a=>{:function(" * 200_000),
    "a WAD of 44 bytes": wad,
    "a map of 5.4 GB": frames_map,
    "pictures of a map": pictures_of_a_map,
    "a chunk of 4 GB in an MCAP file": bag(mcap),
    "a description of tables": description(lambda: "a = " + "[" * 100_000),
}
"""Each writes its file into a folder and returns what reads it."""

SLOW = ("as large as may be", "a map of", "a large photo to go to")
"""In the names of cases that take seconds or gigabytes."""


def memory(name):
    """``VmRSS`` (memory now) or ``VmHWM`` (at its most) of this process, gigabytes."""
    return int(Path("/proc/self/status").read_text().split(f"{name}:")[1].split()[0]) / 2**20


def told(read):
    """In a fork: how much more memory reading takes, its processes' included, and what came of it."""
    signal.alarm(10 * SECONDS)  # of one that waits
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS + 1, SECONDS + 1))
    Path("/proc/self/clear_refs").write_text("5")  # the most so far is forgotten
    before = memory("VmRSS")
    try:
        read()
        said = "read"
    except ValueError as error:
        said = "one line" if "\n" not in str(error) and len(str(error)) < 2000 else "MORE THAN ONE LINE"
        said += f": {' '.join(str(error).split())[-120:]}"
    except BaseException as error:
        said = f"TRACEBACK: {type(error).__name__}: {' '.join(str(error).split())[:100]}"
    apart = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 2**20
    yield f"{max(memory('VmHWM') - before, apart)} {said}"


def try_case(make, folder):
    """What came of reading a file in a fork, seconds of the processor and gigabytes."""
    lines, ended, seconds = in_a_fork(partial(told, make(folder)), 6 * 2**30)
    more, _, said = "".join(lines).partition(" ")
    more = float(more or "nan")
    if ended or not lines:
        said = f"HANG OR CRASH by signal {ended}"
    elif seconds > SECONDS or more > MEMORY:
        said = f"TOO MUCH: {said}"
    return said, seconds, more


def failed(said):
    """Whether a case did not end as it should."""
    return not said.startswith(("read", "one line"))


def main(*names):
    """Try the cases of these names, or all; how many failed."""
    bad, quick = 0, [name for name in CASES if not any(slow in name for slow in SLOW)]
    names = quick if names == ("quick",) else names or [*CASES]
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            said, seconds, more = try_case(CASES[name], Path(folder))
        bad += failed(said)
        print(f"{name} | {seconds:.1f} s | {more:.2f} GB | {said}", flush=True)
    print(f"\n{len(names)} cases, {bad} failed")
    return bad


if __name__ == "__main__":
    sys.exit(bool(main(*sys.argv[1:])))
