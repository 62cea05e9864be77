"""The camera views of a dump: read and decoded one at a time, on access."""

import io
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps, UnidentifiedImageError

MAX_PIXELS = 2**24
"""Of a view; larger ones are refused before they are unpacked."""

MAX_PHOTO_PIXELS = 2**28
"""Of a photo; as RGB it takes three bytes for each."""

FORMATS = ("WEBP", "PNG", "JPEG")
"""Of images. Pillow knows many more, and for some of them starts other programs (Ghostscript for EPS)."""


class ImageError(ValueError):
    """Bytes that are no image of a known format; the message says why, on one line."""


@dataclass(frozen=True, eq=False)
class Views:
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
        """The view of a state as RGB, uint8 ``[H, W, 3]``.

        Raises:
            IndexError: there is no such state.
            ValueError: its view cannot be read or decoded; the file was changed after the scene was read.
        """
        if not 0 <= state < len(self):
            raise IndexError(f"{self.path}: state {state} has no view; states are 0..{len(self) - 1}")
        if self.unpacked is not None:
            return self.unpacked[state].copy()
        stored = self._stored(state)
        if self.shape is not None:
            return np.frombuffer(bytearray(stored), np.uint8).reshape(*self.shape, 3)
        try:
            return decode(stored)
        except ImageError as error:
            raise ValueError(f"{self.path}: {self.dataset}: state {state}: not a readable image ({error})") from None

    def encoded(self, state: int) -> bytes | None:
        """The stored bytes of an encoded view; None where views are stored as raw pixels."""
        return None if self.dataset == "observation" else self._stored(state)

    def _stored(self, state: int) -> bytes:
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


def encode(view: NDArray[np.uint8], quality: int | None = 85) -> bytes:
    """A view as WebP bytes; ``quality`` is WebP's, 0 to 100, or None for lossless."""
    buffer = io.BytesIO()
    if quality is None:
        # Thirteen times as fast as Pillow's defaults, and 11 % larger.
        Image.fromarray(view).save(buffer, "WEBP", lossless=True, method=0, quality=50)
    else:
        Image.fromarray(view).save(buffer, "WEBP", quality=quality, method=6)
    return buffer.getvalue()


def decode(data: bytes) -> NDArray[np.uint8]:
    """The RGB image, uint8 ``[H, W, 3]``, in the bytes of an encoded one; `ImageError` if there is none."""
    return np.asarray(open_image(data, MAX_PIXELS).convert("RGB"))


def open_image(data: bytes, max_pixels: int, *, load: bool = True) -> Image.Image:
    """The image in the bytes of a file in one of `FORMATS`, of at most so many pixels.

    Without ``load`` its pixels are not decoded, and it tells the size that it declares. `ImageError` if it is none.
    """
    limit, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None  # panoramas are larger than Pillow takes a photo to be
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of odd metadata
            image = Image.open(io.BytesIO(data), formats=FORMATS)
            if image.width * image.height > max_pixels:
                raise ImageError(f"{image.width}x{image.height} pixels are more than {max_pixels}")
            if load:
                image.load()
    except ImageError:
        raise
    except UnidentifiedImageError:
        raise ImageError("it is not WebP, PNG or JPEG") from None
    except Exception as error:  # Pillow raises many kinds for damaged images, struct.error and SyntaxError among them
        raise ImageError(" ".join(f"{type(error).__name__}: {error}".split())[:200]) from None
    finally:
        Image.MAX_IMAGE_PIXELS = limit
    return image


def read_photo(file: str | Path) -> NDArray[np.uint8]:
    """Return the photo in a file, upright as its EXIF says, RGB, uint8 ``[H, W, 3]``; `ImageError` if there is none."""
    try:
        return np.asarray(ImageOps.exif_transpose(open_image(Path(file).read_bytes(), MAX_PHOTO_PIXELS)).convert("RGB"))
    except (OSError, ImageError) as error:
        raise ImageError(f"{file}: {getattr(error, 'strerror', None) or error}") from None
