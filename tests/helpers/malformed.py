"""Malformed dumps: ways to spoil a good file of 24 states, each given the open file; and what the error says."""

import io

import h5py
import numpy as np
import pytest
from PIL import Image
from rooms import grid_scene, published_dump, read_here

from dirl.scenes import SceneError
from dirl.scenes.views import encode

VIEW = encode(np.arange(12 * 16 * 3, dtype=np.uint8).reshape(12, 16, 3))


def instead(name, value):
    """Another dataset of that name; none if it is None."""

    def spoil(file):
        file.pop(name, None)
        if value is not None:
            file[name] = value

    return spoil


def hollow(name, shape, dtype="f4"):
    """A dataset of that shape that was never filled."""

    def spoil(file):
        file.pop(name, None)
        file.create_dataset(name, shape, dtype, chunks=tuple(min(size, 64) for size in shape))

    return spoil


def views(*last):
    """Encoded views that are good but for the last ones."""

    def spoil(file):
        stored = file.create_dataset("observation_webp", (24,), h5py.vlen_dtype(np.uint8))
        for state, data in enumerate([VIEW] * (24 - len(last)) + list(last)):
            stored[state] = np.frombuffer(data, np.uint8)

    return spoil


def picture(kind, size=(16, 12), mode="RGB"):
    """A black image as the bytes of a file."""
    buffer = io.BytesIO()
    Image.new(mode, size).save(buffer, kind)
    return buffer.getvalue()


def make(path, spoil):
    """A good file of 24 states, spoiled."""
    published_dump(path, grid_scene())
    with h5py.File(path, "a") as file:
        spoil(file)
    return path


def refused(path):
    """What the one `SceneError` says after the name of the file."""
    with pytest.raises(SceneError) as caught:
        read_here(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert caught.value.__cause__ is None
    assert caught.value.__context__ is None or caught.value.__suppress_context__  # one error, not a chain
    assert "\n" not in message
    return message.removeprefix(f"{path}: ")
