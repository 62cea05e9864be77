"""First-person recordings: the frames of a video, or of a folder of images."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps
from tqdm import tqdm

from dirl.scenes.scene import SceneError
from dirl.scenes.views import ImageError, open_image

HEIGHT = 120
"""Of the frames that are kept, pixels."""

MAX_PIXELS = 2**28

SUFFIXES = {".jpg", ".jpeg", ".png", ".webp"}
"""Of the images of a folder."""


def read_frames(source: str | Path, every: int = 1, height: int = HEIGHT) -> NDArray[np.uint8]:
    """Frames of a recording, RGB, uint8 ``[N, height, W, 3]``.

    Args:
        source: a video that ffmpeg reads, or a folder of images, in the order of their names.
        every: so many frames there is one that is kept.
        height: pixels; the width keeps the shape.

    Raises:
        SceneError: there is no such video or folder, it has fewer than two frames, or it cannot be decoded.
    """
    path = Path(source)
    if path.is_dir():
        files = sorted(file for file in path.iterdir() if file.suffix.lower() in SUFFIXES)[::every]
        frames = [read_photo(file, height) for file in tqdm(files, desc="frames", unit="", disable=None)]
        if len({frame.shape for frame in frames}) > 1:
            raise SceneError(f"{source}: the images are of different shapes; a recording is of one camera")
    elif path.is_file():
        frames = _decoded(path, every, height)
    else:
        raise SceneError(f"{source}: there is no such video or folder of images")
    if len(frames) < 2:
        raise SceneError(f"{source}: has {len(frames)} frames to keep; at least two are needed")
    return np.stack(frames)


def read_photo(file: str | Path, height: int = HEIGHT) -> NDArray[np.uint8]:
    """A photo, RGB, uint8 ``[height, W, 3]``; `SceneError` if it cannot be decoded."""
    try:
        image = ImageOps.exif_transpose(open_image(Path(file).read_bytes(), MAX_PIXELS))
    except (OSError, ImageError) as error:
        raise SceneError(f"{file}: {getattr(error, 'strerror', None) or error}") from None
    return _small(image, height)


def _small(image: Image.Image, height: int) -> NDArray[np.uint8]:
    size = max(1, round(image.width * height / image.height)), height
    return np.asarray(image.convert("RGB").resize(size, Image.Resampling.BOX))


def _decoded(file: Path, every: int, height: int) -> list[NDArray[np.uint8]]:
    try:
        import imageio_ffmpeg
    except ImportError:
        raise SceneError(f"{file}: a video needs a package that is not installed: pip install 'dirl[video]'") from None
    frames = []
    try:
        reader = imageio_ffmpeg.read_frames(str(file))
        size = next(reader)["size"]
        for number, data in enumerate(tqdm(reader, desc="frames", unit="", disable=None)):
            if number % every == 0:
                frames.append(_small(Image.frombytes("RGB", size, data), height))
    except (OSError, RuntimeError, StopIteration, KeyError, ValueError) as error:
        raise SceneError(f"{file}: is no video that ffmpeg reads ({type(error).__name__})") from None
    return frames
