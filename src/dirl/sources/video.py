"""First-person recordings: the frames of a video, of a folder of images, or of a bag of ROS, one after the other."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import islice
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from dirl.scenes.io.files import FREELY_UNPACKED
from dirl.scenes.io.read import SECONDS, environment, limit, why_ended
from dirl.scenes.scene import SceneError
from dirl.scenes.views import (
    MAX_PHOTO_PIXELS,
    SUFFIXES,
    ImageError,
    natural_order,
    open_image,
    open_photo,
    photo_field_of_view,
)

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.interfaces import Connection

SIDE = 480
"""Pixels of the longer side of frames as they are compared."""

OTHER_PICTURES = (".heic", ".heif", ".avif", ".tif", ".tiff", ".bmp", ".gif", ".dng", ".jp2", ".jxl", ".pgm", ".ppm")
"""Suffixes of pictures that are not read: a recording in which they were left out would have holes."""

FORMATS = "mov,matroska,avi,mpeg,mpegts,asf,flv,ogg"
"""Demuxers of ffmpeg that read videos alone. Others turn texts into pictures, or open files that a list names."""

BAGS = (".bag", ".mcap", ".db3")

MOST_RATIO = 100
"""What frames of more than `FREELY_UNPACKED` bytes may be, in sizes of their file."""

MEMORY, SECONDS_A_MEGABYTE = 2 * 2**30, 20.0
"""Bytes of address space of the process that reads a video or bag: a chunk of a megabyte may unpack to many gigabytes;
and its processor time: a megabyte may hold a minute of a video in which little moves."""

ENCODINGS = {
    "rgb8": ("RGB", "RGB"),
    "bgr8": ("RGB", "BGR"),
    "rgba8": ("RGB", "RGBX"),
    "bgra8": ("RGB", "BGRX"),
    "mono8": ("L", "L"),
}
"""For raw images of a bag: Pillow's mode, and how the bytes lie."""


class Frame(NamedTuple):
    """A frame of a recording."""

    image: NDArray[np.uint8]
    """RGB, ``[H, W, 3]``, its longer side `SIDE` pixels or less."""
    time: float
    """Seconds from the beginning."""
    place: tuple[float, float, float] | None = None
    """x, y (metres) and heading (degrees, to the left) by the odometry of a bag; None without one."""


@dataclass
class Recording:
    """A recording that was looked into, but not decoded yet; iterate over it for its frames.

    Args:
        source: a video, a folder of images, or a bag.
        every: seconds between frames that are kept. Of a folder each image is kept, and they are taken to be so many
            seconds apart: it holds no times.
        topic: of the images of a bag; may be left out if there is one.
        odometry: topic of ``nav_msgs/Odometry`` of a bag; may be left out if there is one.

    Raises:
        SceneError: it is no recording, or one that cannot be read; the message says what to do.
    """

    source: Path
    every: float = 1.0
    topic: str | None = None
    odometry: str | None = None

    def __post_init__(self) -> None:
        self.files: list[Path] = []
        self.left_out: list[str] = []
        self.field_of_view: float | None = None
        """Degrees from left to right, where the first image of a folder tells the focal length of 35 mm film."""
        if self.source.is_dir() and not (self.source / "metadata.yaml").is_file():
            self._list_images()
            self.count = len(self.files)
        elif not self.source.is_dir() and not self.source.is_file():  # who reads a pipe waits for its end
            raise SceneError(f"{self.source}: there is no such video, folder of images or bag")
        else:
            self.count = int(next(self._read_apart()).time / self.every) + 1
            """Frames that will be kept, about."""

    def __iter__(self) -> Iterator[Frame]:
        if self.files:
            return (Frame(read_photo(file), number * self.every) for number, file in enumerate(self.files))
        return islice(self._read_apart(), 1, None)

    def _list_images(self) -> None:
        names = [file for file in self.source.iterdir() if file.is_file() and not file.name.startswith(".")]
        if others := sorted(file.name for file in names if file.suffix.lower() in OTHER_PICTURES):
            raise SceneError(
                f"{self.source}: {others[0]} ({len(others)} of this kind): pictures that are not read; convert them to "
                "JPEG, or the recording would have holes"
            )
        self.files = sorted((file for file in names if file.suffix.lower() in SUFFIXES), key=natural_order)
        self.left_out = sorted(file.name for file in names if file not in set(self.files))
        if not self.files:
            raise SceneError(f"{self.source}: holds no images ({', '.join(SUFFIXES)})")
        self.field_of_view = photo_field_of_view(self.files[0])

    def _read_apart(self) -> Iterator[Frame]:
        """Yield what `write_frames` writes in a process of its own: the end, without pixels, then the frames."""
        files = self.source.iterdir() if self.source.is_dir() else [self.source]
        size = sum(file.stat().st_size for file in files)
        seconds = SECONDS + SECONDS_A_MEGABYTE * size / 1e6
        request = {**asdict(self), "source": str(self.source.absolute())}
        code = f"from dirl.sources.video import write_frames; write_frames({size}, {seconds}, **{request})"
        command = [sys.executable, "-S", "-P", "-c", code]
        with (
            tempfile.TemporaryDirectory() as folder,  # where a bag that is compressed as a whole is unpacked
            subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env={**environment(), "TMPDIR": folder}
            ) as process,
        ):
            answers: Any = process.stdout
            while line := answers.readline():
                answer = json.loads(line)
                if isinstance(answer, str):
                    raise SceneError(f"{self.source}: {answer}")
                time, place, shape = answer
                yield Frame(np.frombuffer(answers.read(prod(shape)), np.uint8).reshape(shape), time, place)
            if status := process.wait():
                raise SceneError(f"{self.source}: {why_ended(status, seconds, 'its reader')}")


def read_photo(file: str | Path) -> NDArray[np.uint8]:
    """Return a photo, upright, RGB, uint8 ``[H, W, 3]``, its longer side `SIDE` pixels or less.

    Raises:
        SceneError: it cannot be decoded, or has 16 bits.
    """
    return _small(file, open_photo(file))


def _small(source: str | Path, image: Image.Image) -> NDArray[np.uint8]:
    if image.mode.startswith(("I", "F")):
        raise SceneError(f"{source}: a picture of 16 bits or more, as of depth or heat; convert it to 8 bits")
    scale = min(1.0, SIDE / max(image.size))
    size = max(1, round(image.width * scale)), max(1, round(image.height * scale))
    return np.asarray(image.convert("RGB").resize(size, Image.Resampling.BOX))


def write_frames(size: int, seconds: float, source: str, every: float, topic: str | None, odometry: str | None) -> None:
    """Write what is in a video or bag of so many bytes to the standard output; runs in a process of its own.

    It is a line of JSON for each frame, with its pixels after it; a text is an error. A damaged file may make libraries
    crash or hang, and a chunk of a megabyte may unpack to many gigabytes.
    """
    limit("RLIMIT_AS", MEMORY)
    limit("RLIMIT_FSIZE", max(FREELY_UNPACKED, MOST_RATIO * size))
    limit("RLIMIT_CPU", seconds)
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what the readers of bags print
    file = Path(source)
    is_bag = file.is_dir() or file.suffix in BAGS
    try:
        for image, time, place in _bag_frames(file, every, topic, odometry) if is_bag else _video_frames(file, every):
            answers.write(json.dumps([time, place, image.shape]).encode() + b"\n" + image.tobytes())
    except SceneError as error:
        answers.write(json.dumps(str(error)).encode() + b"\n")
    except Exception as error:  # each library raises its own
        reason = " ".join(str(getattr(error, "strerror", None) or error).split())[:120]
        kind = "bag" if is_bag else "video"
        answers.write(json.dumps(f"is no {kind} that is read ({type(error).__name__}: {reason})").encode() + b"\n")
    answers.close()


def _video_frames(source: Path, every: float) -> Iterator[Frame]:
    """Yield the end of a video, without pixels, and then frames by their time stamps.

    These are the first one, and each that is ``every`` seconds or more after the last.
    """
    try:
        import av
    except ImportError:
        raise SceneError("a video needs a package that is not installed: pip install 'dirl[video]'") from None
    av.logging.set_level(av.logging.ERROR)
    only = {"protocol_whitelist": "file", "format_whitelist": FORMATS}
    # FFmpeg says where a video is damaged, and goes on.
    with av.logging.Capture(local=False) as damages, av.open(f"file:{source}", options=only) as container:
        stream: Any = container.streams.best("video")
        if stream is None:
            raise SceneError("is no video that is read (it has no pictures)")
        yield Frame(np.zeros((0, 0, 3), np.uint8), (container.duration or 0) / av.time_base)
        stream.thread_type, stream.thread_count = "AUTO", 4
        start, last, kept = None, -np.inf, 0
        try:
            for frame in container.decode(stream):
                start = frame.time if start is None else start
                time = frame.time - start
                if time - last >= 0.999 * every:
                    last, kept = time, kept + 1
                    yield Frame(np.rot90(_small("a frame", frame.to_image()), frame.rotation // 90), time)
        except av.FFmpegError as error:
            damages.append((av.logging.ERROR, "", str(error.strerror)))
        if damages:
            reason = " ".join(damages[0][2].split())[:120]  # threads may speak at once, in several lines
            raise SceneError(f"is damaged after {kept} frames ({reason})")


def _bag_frames(source: Path, every: float, topic: str | None, odometry_topic: str | None) -> Iterator[Frame]:
    """Yield the end of a bag, without pixels, and then its frames."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise SceneError("a bag needs a package that is not installed: pip install 'dirl[bags]'") from None
    # A bag without definitions of its own is of ROS 2; those of images and odometry are alike in all its versions.
    with AnyReader([source], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        yield Frame(np.zeros((0, 0, 3), np.uint8), reader.duration / 1e9)
        images = _connections(reader, "topic", topic, ("Image", "CompressedImage"))
        if not images:
            raise SceneError(f"has no topic of images; it has {_topics(reader)}")
        odometry = _connections(reader, "odometry", odometry_topic, ("Odometry",))
        place, start, last = None, None, -np.inf
        for connection, stamp, data in reader.messages(images + odometry):
            if connection in odometry:
                place = _pose(reader.deserialize(data, connection.msgtype))
                continue
            start = stamp if start is None else start
            time = (stamp - start) / 1e9
            if time - last >= 0.999 * every:
                last = time
                yield Frame(_message_image(reader.deserialize(data, connection.msgtype)), time, place)


def _connections(reader: "AnyReader", option: str, topic: str | None, kinds: tuple[str, ...]) -> "list[Connection]":
    """Return connections of one topic of these kinds of messages; none if there is no such topic nor one asked for."""
    connections = [connection for connection in reader.connections if connection.msgtype.rpartition("/")[2] in kinds]
    names = sorted({connection.topic for connection in connections})
    if topic is None and len(names) > 1:
        raise SceneError(f"choose {option}= of {', '.join(names)}")
    if topic is not None and topic not in names:
        raise SceneError(f"has no {option} {topic} of {' or '.join(kinds)}; it has {_topics(reader)}")
    return [connection for connection in connections if topic in (None, connection.topic)]


def _topics(reader: "AnyReader") -> str:
    return ", ".join(sorted(f"{each.topic} ({each.msgtype})" for each in reader.connections)) or "none"


def _pose(message: Any) -> tuple[float, float, float]:
    """Return where odometry is, metres, and its heading, degrees to the left."""
    at, turn = message.pose.pose.position, message.pose.pose.orientation
    heading = np.arctan2(2 * (turn.w * turn.z + turn.x * turn.y), 1 - 2 * (turn.y**2 + turn.z**2))
    if not np.isfinite(place := (float(at.x), float(at.y), float(np.degrees(heading)))).all():
        raise SceneError("its odometry gives places that are no numbers")
    return place


def _message_image(message: Any) -> NDArray[np.uint8]:
    """Return the picture of a message ``Image`` or ``CompressedImage``."""
    data = message.data.tobytes()
    if not hasattr(message, "encoding"):
        try:
            return _small("an image", open_image(data, MAX_PHOTO_PIXELS))
        except ImageError as error:
            raise SceneError(f"an image of format '{message.format}' is not read ({error})") from None
    if message.encoding not in ENCODINGS:
        choices = ", ".join(ENCODINGS)
        raise SceneError(f"images of encoding {message.encoding} are not read; expected {choices}")
    mode, raw = ENCODINGS[message.encoding]
    return _small("an image", Image.frombytes(mode, (message.width, message.height), data, "raw", raw, message.step, 1))
