"""Views: three formats of images and no other, decoded when somebody looks."""

import warnings
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from malformed import VIEW, picture
from PIL import Image
from rooms import grid_scene, read_here

from dirl.scenes import write_dump
from dirl.scenes.views import FORMATS, ImageError, decode


def reason(data):
    """Why an image cannot be decoded; empty if it can."""
    try:
        return "" if decode(data).shape[2] == 3 else "no RGB"
    except ImageError as error:
        return str(error)


def test_decoding_in_threads_changes_nothing_of_the_process(monkeypatch):
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 100)
    filters, data = [*warnings.filters], picture("PNG", (40, 30))
    with ThreadPoolExecutor(4) as threads:
        assert {view.shape for view in threads.map(decode, [data] * 400)} == {(30, 40, 3)}
    assert Image.MAX_IMAGE_PIXELS == 100
    assert warnings.filters == filters


@pytest.mark.parametrize("kind", FORMATS)
def test_damaged_images_are_one_line(kind):
    data, rng = picture(kind, (40, 30)), np.random.default_rng(0)
    reasons = []
    for length in range(1, len(data), 7):
        broken = bytearray(data[:length])
        broken[rng.integers(length)] ^= 0xFF
        reasons.append(reason(bytes(broken)))
    assert any(reasons)
    assert not any("\n" in text or "0x" in text for text in reasons)  # no addresses of objects


def test_a_file_that_went_away_or_became_shorter_is_one_line(tmp_path):
    path = tmp_path / "room.h5"
    write_dump(path, grid_scene(), [VIEW] * 24)
    views = read_here(path).views
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(ValueError, match=r"room\.h5: observation_webp: state 5: the file has become shorter$"):
        views[5]
    path.unlink()
    with pytest.raises(ValueError, match=r"room\.h5: observation_webp: cannot be read any more \(No such file"):
        views.encoded(5)
