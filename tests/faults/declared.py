"""Give every reader small files that declare much: each ends in 60 s of processor time and 2 GB, with one line.

    nice python tests/faults/declared.py [quick | name ...]

Each case writes a file of at most 24 MB and reads it in a fork, as a recipe would. It prints a line for each case: what
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
from dirl.reporting.inspection import draw_sheet
from dirl.runs.checkpoints import load_checkpoint
from dirl.scenes.io.files import read_weights
from dirl.sources.photos import encoded_photos, read_photos
from dirl.sources.rooms import read_description
from dirl.sources.tours import read_tour
from dirl.sources.tours.pixels import cut_views
from dirl.sources.video import Recording, read_photo
from dirl.sources.vizdoom import _check_map

SECONDS, MEMORY = 60, 2.0
"""Of the processor, and gigabytes."""


def png(width, height, colour=0, bits=8):
    """A PNG of zeros of this size: a small file, whatever the size; each row is the same few compressed bytes."""
    channels = {0: 1, 2: 3, 6: 4}[colour]
    row, packer = bytes(1 + (width * channels * bits + 7) // 8), zlib.compressobj(1, wbits=-15)
    packed = packer.compress(row) + packer.flush(zlib.Z_FULL_FLUSH)
    checked = struct.pack(">HH", len(row) * height % 65_521, 1)  # Adler-32 of zeros
    data = b"\x78\x01" + height * packed + b"\x03\x00" + checked
    parts = [(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0)), (b"IDAT", data)]
    body = b"".join(
        struct.pack(">I", len(part)) + kind + part + struct.pack(">I", zlib.crc32(kind + part))
        for kind, part in [*parts, (b"IEND", b"")]
    )
    return b"\x89PNG\r\n\x1a\n" + body


def sparse(file):
    """A terabyte that takes no room."""
    file.touch()
    os.truncate(file, 2**40)


def of_its_folder(read):
    """A reader of a folder as one of a file in it."""
    return lambda file: read(file.parent)


def tour(name, text):
    return name, text, of_its_folder(read_tour)


def scenes_of_marzipano(count, **scene):
    text = json.dumps([{"id": f"s{number}", **scene} for number in range(count)])
    return f"var APP_DATA = {{scenes: {text}}};"


def cut(file):
    """A view of each panorama of the tour that a file belongs to."""
    images = [one.image for one in read_tour(file.parent).panoramas]
    list(cut_views(images, np.zeros((len(images), 1)), size=(300, 400), field_of_view=90))


def panorama(width, height, **options):
    def content(file):
        file.with_name("b.png").write_bytes(png(64, 32))
        file.with_name("links.csv").write_text("image,to,yaw\na.png,b.png,0\nb.png,a.png,0\n")
        return png(width, height, **options)

    return "a.png", content, cut


def cube(file):
    scene = {"type": "cubemap", "cubeMap": ["a.png"] * 6}
    file.with_name("tour.json").write_text(json.dumps({"scenes": {"a": scene}}))
    return png(11_584, 11_584)


def encoded(file):
    list(encoded_photos([file], 300, 400))


def webp(_):
    """The header of a WebP file that declares a canvas of 16,383 pixels a side."""
    sides = 2 * struct.pack("<I", 16_382)[:3]
    chunk = b"VP8X" + struct.pack("<I", 10) + bytes(4) + sides
    pixel = b"VP8L" + struct.pack("<I", 14) + bytes.fromhex("2f000000103f1111100a20d2ff88")
    return b"RIFF" + struct.pack("<I", 4 + len(chunk + pixel)) + b"WEBP" + chunk + pixel


def weights(file):
    torch.save({"a": torch.zeros(1, dtype=torch.float16).expand(7 * 10**8)}, file)


def pictures_of_a_map(file):
    """Small files of pictures that are far larger than any in a map."""
    pictures, count = png(2**24, 1), 16
    looks = np.zeros((count, 8), np.float16)
    points = np.zeros((count, 4, 2), np.float16), np.zeros((count, 4, 64), np.int8), np.zeros(count, np.int16)
    views, links = Described(looks, *points), np.zeros((0, 2), np.int64)
    times, parts = np.arange(count, dtype=float), np.zeros(count, np.int64)
    FrameMap([pictures] * count, times, parts, views, links, 65.0, "sift", (8, 8)).save(file)


def draw(file):
    graph = load_frames_map(file)
    draw_sheet([(f"{frame}", graph.picture(frame)) for frame in range(len(graph))], file.with_suffix(".png"))


def mcap(_):
    """A file of MCAP without an index, whose one chunk unpacks to 4 GB of zeros."""
    size, packer, megabyte = 2**32, zstd.ZstdCompressor(), bytes(2**20)

    def record(kind, data):
        return bytes([kind]) + struct.pack("<Q", len(data)) + data

    def text(word):
        return struct.pack("<I", len(word)) + word

    chunk = b"".join([packer.compress(megabyte) for _ in range(size // len(megabyte))] + [packer.flush()])
    about = struct.pack("<QQQI", 0, 10, size, 0) + text(b"zstd") + struct.pack("<Q", len(chunk))
    records = record(1, text(b"ros2") + text(b"")) + record(6, about + chunk)
    end = record(15, struct.pack("<I", 0)) + record(2, struct.pack("<QQI", 0, 0, 0))
    return b"\x89MCAP0\r\n" + records + end + b"\x89MCAP0\r\n"


KRPANO = '<krpano><scene name="a"><image><cube url="%s"/></image></scene></krpano>'
WAD = struct.pack("<4sii", b"PWAD", 2**31 - 1, 12) + bytes(32)
TILES = [{"size": 64, "tileSize": 1}] * 16

CASES = {
    "a data.js of comments": tour("data.js", "/**/" * 40 + "function () {}"),
    "a page of a comment without end": tour("index.html", 'scenes: v = {"a": ' + "/*" * 500_000),
    "a page of braces": tour("index.html", "scenes: {" * 100_000),
    "tiles of one pixel": tour("data.js", lambda _: scenes_of_marzipano(200, levels=TILES)),
    "an address with 300,000 zeros": tour("tour.xml", KRPANO % f"%{'0' * 300_000}s.jpg"),
    "5 million elements": tour("tour.xml", lambda _: f"<krpano>{'<a/>' * 1_500_000}</krpano>"),
    "a large panorama": panorama(28_000, 14_000),
    "a panorama as large as may be": panorama(19_998, 9_999, colour=2),
    "a face of a cube as large as may be": ("a.png", cube, cut),
    "a large photograph": ("a.png", lambda _: png(16_384, 16_384, colour=6), encoded),
    "a photograph as large as may be": ("a.png", lambda _: png(15_000, 13_300, colour=6), encoded),
    "a large canvas of WebP": ("a.webp", webp, encoded),
    "a large photo to go to": ("a.png", lambda _: png(16_384, 16_384, colour=6), read_photo),
    "a sparse states.csv": ("states.csv", sparse, of_its_folder(read_photos)),
    "a sparse checkpoint": ("network.pt", sparse, of_its_folder(load_checkpoint)),
    "weights that repeat a number": ("a.pt", weights, read_weights),
    "a pipe for tour.json": tour("tour.json", os.mkfifo),
    "a pipe for a room": ("a.toml", os.mkfifo, read_description),
    "functions without end": tour("index.html", "scenes: {" + ":function(){:a=>{:function(" * 200_000),
    "a WAD of 44 bytes": ("a.wad", WAD, lambda file: _check_map(file, "map01")),
    "pictures of a map": ("a.pt", pictures_of_a_map, draw),
    "a chunk of 4 GB in an MCAP file": ("a.mcap", mcap, lambda file: list(Recording(file))),
    "a description of tables": ("a.toml", "a = " + "[" * 100_000, read_description),
}
"""Each the name of a file, what it holds, or a function that tells or makes it, and what reads it."""

SLOW = ("as large as may be", "a large photo to go to", "5 million elements")
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


def try_case(name, content, read):
    """What came of reading a file in a fork, seconds of the processor and gigabytes."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / name
        made = content(file) if callable(content) else content
        if made is not None:
            file.write_bytes(made.encode() if isinstance(made, str) else made)
        lines, ended, seconds = in_a_fork(partial(told, partial(read, file)), 6 * 2**30)
    more, _, said = "".join(lines).partition(" ")
    more = float(more or "nan")
    if ended or not lines:
        said = f"HANG OR CRASH by signal {ended}"
    elif seconds > SECONDS or more > MEMORY:
        said = f"TOO MUCH: {said}"
    return said, seconds, more


def main(*names):
    """Try the cases of these names, or all; how many failed."""
    bad, quick = 0, [name for name in CASES if not any(slow in name for slow in SLOW)]
    names = quick if names == ("quick",) else names or [*CASES]
    for name in names:
        said, seconds, more = try_case(*CASES[name])
        bad += not said.startswith(("read", "one line"))
        print(f"{name} | {seconds:.1f} s | {more:.2f} GB | {said}", flush=True)
    print(f"\n{len(names)} cases, {bad} failed")
    return bad


if __name__ == "__main__":
    sys.exit(bool(main(*sys.argv[1:])))
