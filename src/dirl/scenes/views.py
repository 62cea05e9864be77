"""Camera views as they lie in a dump: decoded one at a time, when somebody looks."""

import io
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray
from PIL import Image

MAX_PIXELS = 2**24
"""Of a view; larger ones are refused before they are unpacked."""


@dataclass(frozen=True)
class Views:
    """The views of one dump file.

    Args:
        path: the HDF5 file.
        dataset: ``observation`` (uint8 ``[N, H, W, 3]``) or ``observation_webp`` (N encoded images).
        states: how many views there are, N.
    """

    path: Path
    dataset: str
    states: int

    def __len__(self) -> int:
        return self.states

    def __getitem__(self, state: int) -> NDArray[np.uint8]:
        """The view of a state as RGB, uint8 ``[H, W, 3]``.

        Raises:
            IndexError: there is no such state.
            ValueError: its view cannot be decoded.
        """
        if not 0 <= state < self.states:
            raise IndexError(f"{self.path}: state {state} has no view; states are 0..{self.states - 1}")
        with h5py.File(self.path) as file:
            stored = file[self.dataset][state]
        if self.dataset == "observation":
            return np.asarray(stored)
        try:
            return decode(stored.tobytes())
        except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
            raise ValueError(f"{self.path}: {self.dataset}: state {state}: not a readable image ({error})") from None

    def encoded(self, state: int) -> bytes | None:
        """The stored bytes of an encoded view; None where views are stored as raw pixels."""
        if self.dataset == "observation":
            return None
        with h5py.File(self.path) as file:
            return file[self.dataset][state].tobytes()


def encode(view: NDArray[np.uint8], quality: int | None = 85) -> bytes:
    """A view as WebP bytes; ``quality`` is WebP's, 0 to 100, or None to lose nothing."""
    buffer = io.BytesIO()
    if quality is None:
        Image.fromarray(view).save(buffer, "WEBP", lossless=True)
    else:
        Image.fromarray(view).save(buffer, "WEBP", quality=quality, method=6)
    return buffer.getvalue()


def decode(data: bytes) -> NDArray[np.uint8]:
    """The RGB image, uint8 ``[H, W, 3]``, in the bytes of an encoded one."""
    with Image.open(io.BytesIO(data)) as image:
        if image.width * image.height > MAX_PIXELS:
            raise ValueError(f"{image.width}x{image.height} pixels are more than {MAX_PIXELS}")
        return np.asarray(image.convert("RGB"))
