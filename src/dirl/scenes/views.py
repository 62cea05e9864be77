"""The camera views of a dump: read and decoded one at a time, on access."""

import io
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image, ImageOps
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile
from PIL.WebPImagePlugin import WebPImageFile

from dirl.scenes.errors import SceneError
from dirl.scenes.io.files import read_bytes

MAX_PIXELS = 2**24
"""Of a view; larger ones are refused before they are unpacked."""

MAX_PHOTO_PIXELS = 2 * 10**8
"""Of a photograph or a panorama to be scaled; Pillow takes four bytes for each, and twice that to turn it upright."""

MAX_PHOTO_BYTES = 2**28
"""Of its file."""

MAX_WEBP_PIXELS = 2**26
"""Of a WebP image, whose decoder holds three copies."""

FORMATS = {"PNG": (PngImageFile, b"\x89PNG"), "JPEG": (JpegImageFile, b"\xff\xd8"), "WEBP": (WebPImageFile, b"RIFF")}
"""Of images: Pillow's class, and how a file begins. It knows many more, and starts other programs for some of them."""

SUFFIXES = (".jpg", ".jpeg", ".png", ".webp")
"""Of their files."""


class ImageError(SceneError):
    """Bytes that are no image of a known format; the message says why, on one line."""


class Views(Protocol):
    """The camera images of a scene: an array uint8 ``[N, H, W, 3]``, or anything that gives one image a state."""

    def __len__(self) -> int:
        """Return the number of states."""

    def __getitem__(self, state: int, /) -> NDArray[np.uint8]:
        """Return the view of a state as RGB, uint8 ``[H, W, 3]``."""


@dataclass(frozen=True, eq=False)
class FileViews:
    """The views of one dump file. They are read from the file's bytes, without HDF5.

    Args:
        path: the file.
        dataset: ``observation`` (raw pixels) or ``observation_webp`` (encoded images).
        spans: the position of each view in the file: first byte and number of bytes, int64 ``[N, 2]``.
        shape: height and width of raw pixels; None if the views are encoded.
        unpacked: raw pixels that are compressed in the file, uint8 ``[N, H, W, 3]``; ``spans`` is not used then.
    """

    path: Path
    dataset: str
    spans: NDArray[np.int64]
    shape: tuple[int, int] | None = None
    unpacked: NDArray[np.uint8] | None = None

    def __len__(self) -> int:
        return len(self.spans)

    def __getitem__(self, state: int) -> NDArray[np.uint8]:
        """Return the view of a state as RGB, uint8 ``[H, W, 3]``.

        Raises:
            IndexError: there is no such state.
            ValueError: its view cannot be read or decoded; the file was changed after the scene was read.
        """
        if not 0 <= state < len(self):
            raise IndexError(f"{self.path}: state {state} has no view; states are 0..{len(self) - 1}")
        if self.unpacked is not None:
            return self.unpacked[state].copy()
        stored = self.stored(state)
        if self.shape is not None:
            return np.frombuffer(bytearray(stored), np.uint8).reshape(*self.shape, 3)
        try:
            return decode(stored)
        except ImageError as error:
            raise ValueError(f"{self.path}: {self.dataset}: state {state}: not a readable image ({error})") from None

    def stored(self, state: int) -> bytes:
        """Return the bytes of a view in the file; `ValueError` if they cannot be read any more."""
        start, length = self.spans[state].tolist()
        try:
            with self.path.open("rb") as file:
                file.seek(start)
                stored = file.read(length)
        except OSError as error:
            raise ValueError(f"{self.path}: {self.dataset}: cannot be read any more ({error.strerror})") from None
        if len(stored) < length:
            raise ValueError(f"{self.path}: {self.dataset}: state {state}: the file has become shorter")
        return stored


def check_image(view: NDArray[np.generic], what: str) -> NDArray[np.uint8]:
    """Return a view if it is RGB, uint8 ``[H, W, 3]``; `SceneError` if not."""
    if getattr(view, "dtype", None) != np.uint8 or view.ndim != 3 or view.shape[2] != 3:
        given = f"{getattr(view, 'dtype', type(view).__name__)} {list(getattr(view, 'shape', ()))}"
        raise SceneError(f"{what} gave {given}; expected RGB, uint8 [H, W, 3]")
    return view  # type: ignore[return-value]


def encoded_view(views: Views, state: int, quality: int | None = None) -> bytes:
    """Return the view of a state as the bytes of an image: those of its file, else WebP, see `encode`."""
    if isinstance(views, FileViews) and views.dataset == "observation_webp":
        return views.stored(state)
    return encode(views[state], quality)


def encode(view: NDArray[np.uint8], quality: int | None = 90, method: int = 6) -> bytes:
    """Encode a view as WebP; ``quality`` is 0 to 100, or None for lossless; ``method`` 0 is quick, 6 small."""
    buffer = io.BytesIO()
    if quality is None:
        # Thirteen times as fast as Pillow's defaults, and 11 % larger.
        Image.fromarray(view).save(buffer, "WEBP", lossless=True, method=0, quality=50)
    else:
        Image.fromarray(view).save(buffer, "WEBP", quality=quality, method=method)
    return buffer.getvalue()


def decode(data: bytes) -> NDArray[np.uint8]:
    """Return the RGB image, uint8 ``[H, W, 3]``, in the bytes of an encoded one; `ImageError` if there is none."""
    return np.asarray(to_rgb(open_image(data, MAX_PIXELS)))


def open_image(data: bytes, max_pixels: int, *, load: bool = True) -> Image.Image:
    """Return the image in the bytes of a file in one of `FORMATS`, of at most so many pixels.

    Without ``load`` its pixels are not decoded, and it tells the size that it declares. `ImageError` if it is none.
    Pillow's ``Image.open`` has a limit of its own, for the whole process, below the size of panoramas.
    """
    kind = next((kind for kind, begin in FORMATS.values() if data.startswith(begin)), None)
    if kind is None:
        raise ImageError("it is not WebP, PNG or JPEG")
    most = min(max_pixels, MAX_WEBP_PIXELS) if kind is WebPImageFile else max_pixels
    try:
        image = kind(io.BytesIO(data))
        if image.width * image.height > most:
            raise ImageError(f"{image.width}x{image.height} pixels are more than {most}")
        if load:
            image.load()
    except ImageError:
        raise
    except SyntaxError:
        raise ImageError("it is not WebP, PNG or JPEG") from None
    except Exception as error:  # Pillow raises many kinds for damaged images, struct.error and SyntaxError among them
        raise ImageError(" ".join(f"{type(error).__name__}: {error}".split())[:200]) from None
    return image


def open_photo(file: str | Path, *, load: bool = True) -> Image.Image:
    """Return the photograph in a file, upright as its EXIF says, or with ``load=False`` what it declares.

    It may have `MAX_PHOTO_PIXELS`. `ImageError`, which names the file, if there is none.
    """
    try:
        image = open_image(read_bytes(Path(file), MAX_PHOTO_BYTES), MAX_PHOTO_PIXELS, load=load)
    except OSError as error:
        raise ImageError(f"{file}: {error.strerror or error}") from None
    except ValueError as error:
        raise ImageError(f"{file}: not a readable image ({error})") from None
    try:
        if load:
            ImageOps.exif_transpose(image, in_place=True)
    except Exception as error:  # of damaged EXIF, as SyntaxError and TypeError
        raise ImageError(f"{file}: its EXIF is damaged ({error})") from None
    return image


FILM = math.hypot(36, 24)
"""Millimetres from corner to corner of 35 mm film."""

ANGLES = 10, 150
"""Least and greatest field of view of a photo, degrees from left to right: those of others are not believed."""


def photo_field_of_view(file: str | Path) -> float | None:
    """Return degrees from left to right, by the focal length of 35 mm film in a photo's EXIF; None if there is none.

    That is the length that sees as much from corner to corner, whatever the shape of the photo (CIPA DCG-001).
    """
    try:
        image = open_photo(file, load=False)
        exif = image.getexif()
        focal = float(exif.get_ifd(ExifTags.IFD.Exif).get(ExifTags.Base.FocalLengthIn35mmFilm) or 0)
    except Exception:  # Pillow raises many kinds for damaged EXIF
        return None
    across = exif.get(ExifTags.Base.Orientation, 1) in (5, 6, 7, 8)  # turned when shown
    width = FILM * image.size[across] / math.hypot(*image.size)
    angle = math.degrees(2 * math.atan2(width / 2, focal))
    return angle if ANGLES[0] <= angle <= ANGLES[1] else None


def natural_order(file: Path) -> list[tuple[int, int | str]]:
    """Return a key to sort files as people number them: 2.png before 10.png."""
    return [(0, int(part)) if part.isdecimal() else (1, part) for part in re.split(r"(\d+)", file.name) if part]


def to_rgb(image: Image.Image) -> Image.Image:
    """Return an image as RGB. Grey of 16 bits keeps its upper eight; Pillow's own conversion makes it white."""
    if image.mode.startswith("I"):
        image = Image.fromarray((np.asarray(image) >> 8).astype(np.uint8))
    return image if image.mode == "RGB" else image.convert("RGB")


def read_photo(file: str | Path) -> NDArray[np.uint8]:
    """Return the photo in a file, upright as its EXIF says, RGB, uint8 ``[H, W, 3]``; `ImageError` if there is none."""
    return np.asarray(to_rgb(open_photo(file)))
