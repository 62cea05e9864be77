"""Maps of first-person recordings, in a corridor whose walls change from place to place."""

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from dirl.agent.mapping import MapError
from dirl.agent.mapping.frames import KNOWN, FrameMap, fits, load_frames_map

DEGREE = 2
"""Pixels of a panorama."""

EVERY = 6
"""Steps, after which the walls are others altogether."""


def painted(seed):
    """A panorama of blots, float [60, 720, 3]."""
    generator = torch.Generator().manual_seed(seed)
    blots = torch.rand(1, 3, 12, 90, generator=generator)
    return F.interpolate(blots, (60, 360 * DEGREE), mode="bilinear")[0].permute(1, 2, 0).numpy()


PANORAMAS = [painted(seed) for seed in range(9)]


def view(step, heading=0.0):
    """What is seen after so many steps, 90 degrees wide, uint8 [60, 80, 3]."""
    before, part = divmod(step, EVERY)
    around = PANORAMAS[before] * (1 - part / EVERY) + PANORAMAS[before + 1] * part / EVERY
    bearing = np.degrees(np.arctan((np.arange(80) + 0.5) / 40 - 1)) + heading
    return (255 * around[:, (bearing * DEGREE).astype(int) % (360 * DEGREE)]).astype(np.uint8)


def recording(steps):
    return np.stack([view(step) for step in steps])


def test_where_a_recording_comes_by_again_there_is_a_shortcut():
    twice = FrameMap(recording([*range(40), *range(10, 40)]))
    assert len(twice.shortcuts)
    assert all(abs(first - (second - 30)) <= 2 for first, second in twice.shortcuts)
    far, following = twice.distances_to(np.array([25]))
    assert (far[5], following[5]) == (20, 6)
    assert far[45] < 20  # by a shortcut; without one no way leads back
    assert len(FrameMap(recording(range(40))).shortcuts) == 0


def test_a_photo_fits_best_where_it_was_taken():
    graph = FrameMap(recording(range(48)))
    found = fits(graph, view(30, heading=10))
    assert abs(int(found.argmax()) - 30) <= 1
    assert found.max() > KNOWN
    assert int(fits(graph, view(7, heading=-15)).argmax()) == 7


def test_a_saved_map_is_the_same_and_a_damaged_one_is_refused(tmp_path):
    file = tmp_path / "walk.npz"
    graph = FrameMap(recording([*range(40), *range(10, 40)]), field_of_view=80.0)
    graph.save(file)
    again = load_frames_map(file)
    assert again.field_of_view == 80
    assert np.array_equal(again.frames, graph.frames)
    assert np.array_equal(again.shortcuts, graph.shortcuts)
    file.write_bytes(file.read_bytes()[:1000])
    with pytest.raises(MapError, match="no map that can be read"):
        load_frames_map(file)
    with pytest.raises(MapError, match="no such map"):
        load_frames_map(tmp_path / "none.npz")
    np.savez(file, frames=graph.frames, shortcuts=np.array([[0, 99]]), field_of_view=90.0)
    with pytest.raises(MapError, match="damaged"):
        load_frames_map(file)
    np.savez(file, frames=np.array([object()]), shortcuts=graph.shortcuts, field_of_view=90.0)
    with pytest.raises(MapError, match="no map that can be read"):
        load_frames_map(file)


def test_frames_of_another_form_are_refused():
    with pytest.raises(MapError, match="two or more RGB frames"):
        FrameMap(np.zeros((1, 60, 80, 3), np.uint8))
