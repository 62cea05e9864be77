"""Maps of a policy, animations, and learning curves of several runs."""

import subprocess

import numpy as np
import pytest
from imageio_ffmpeg import get_ffmpeg_exe
from PIL import Image
from rooms import grid_scene

from dirl.reporting import draw_learning_curves, draw_policy, write_gif
from dirl.reporting.animation import FPS, FRAME_MS, HOLD_MS, MAX_FRAMES, episode_frames, write_mp4
from dirl.reporting.curves import common_frames
from dirl.reporting.maps import never_arrives, wedge_corners
from dirl.scenes.graph import AHEAD, RIGHT


def test_states_whose_actions_end_in_a_loop_never_arrive():
    scene = grid_scene(3, 2)
    lost = never_arrives(scene, 0, np.full(len(scene), RIGHT))
    assert np.flatnonzero(~lost).tolist() == [0, 1, 2, 3]  # the goal's place, where turning finds its heading
    lost = never_arrives(scene, 12, np.full(len(scene), AHEAD))
    assert np.flatnonzero(~lost).tolist() == [0, 12]


@pytest.mark.parametrize("turns", [4, 12])
def test_the_wedges_of_a_place_fill_its_cell(turns):
    angles = 2 * np.pi * np.arange(turns) / turns
    corners = wedge_corners(np.ones((turns, 2)), np.stack([np.sin(angles), np.cos(angles)], 1), 0.5, turns)
    x, z = np.moveaxis(corners, 2, 0)
    areas = np.abs((x * np.roll(z, -1, 1) - z * np.roll(x, -1, 1)).sum(1)) / 2
    assert areas.sum() == pytest.approx(0.25)
    assert corners[0, 2] == pytest.approx([1, 1.25])  # facing +z: the upper side


def test_maps_of_a_policy_are_drawn_of_finite_values_of_each_state(tmp_path):
    scene = grid_scene(4, 3, headings=12)
    file = tmp_path / "maps.png"
    chances, fine = np.eye(4)[np.full(len(scene), RIGHT)], np.zeros(len(scene))
    draw_policy(scene, 0, chances, fine, fine + 1, file, title="a policy")
    with Image.open(file) as image:
        assert image.width > 2 * image.height
    with pytest.raises(ValueError, match=r"value: expected shape \(144,\).*found \(143,\)"):
        draw_policy(scene, 0, chances, fine[1:], fine, file, title="")
    broken = np.where(np.arange(len(scene)) == 3, np.nan, fine)
    with pytest.raises(ValueError, match="matching: state 3 "):
        draw_policy(scene, 0, chances, fine, broken, file, title="")


@pytest.mark.parametrize(("path", "frames"), [([7, 4, 5, 6], 4), ([1, 2, 3, 0] * 50, MAX_FRAMES)])
def test_gif_has_a_frame_for_each_state_up_to_a_limit(tmp_path, path, frames):
    write_gif(grid_scene(), 0, path, tmp_path / "e.gif", title="an episode", success=False)
    with Image.open(tmp_path / "e.gif") as image:
        assert image.n_frames == frames


def test_video_holds_the_last_picture_of_each_episode(tmp_path):
    scene = grid_scene()
    episodes = [episode_frames(scene, 0, path, title="an episode", success=True) for path in ([7, 4], [8])]
    write_mp4(episodes, tmp_path / "e.mp4")
    width, height = (size + size % 2 for size in episodes[0][0].size)
    raw = ["-loglevel", "error", "-i", str(tmp_path / "e.mp4"), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    video = subprocess.run([get_ffmpeg_exe(), *raw], capture_output=True, check=True).stdout
    pictures = np.frombuffer(video, np.uint8).reshape(-1, height, width, 3)
    assert len(pictures) == FPS * (FRAME_MS + 2 * HOLD_MS) // 1000
    width, height = episodes[0][0].size
    first, last = (np.asarray(episodes[place][place], np.float32) for place in (0, -1))
    assert np.abs(pictures[0][:height, :width] - first).mean() < 3
    assert np.abs(pictures[-1][:height, :width] - last).mean() < 3 < np.abs(first - last).mean()
    with pytest.raises(OSError, match="no_such"):
        write_mp4(episodes, tmp_path / "no_such" / "e.mp4")


def test_runs_are_compared_where_all_of_them_have_values():
    frames, values = common_frames(
        [(np.array([0.0, 10, 20]), np.array([0.0, 1, 2])), (np.array([5.0, 15]), np.ones(2))]
    )
    assert frames.tolist() == [5, 10, 15]
    assert values.tolist() == [[0.5, 1, 1.5], [1, 1, 1]]


def test_learning_curves_name_the_folder_that_is_no_run(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"there is no reinforcement\.csv"):
        draw_learning_curves({"dirl": [tmp_path]}, tmp_path / "curves.png")
    with pytest.raises(ValueError, match="'dirl' has no runs"):
        draw_learning_curves({"dirl": []}, tmp_path / "curves.png")
