"""Maps of a policy, animations, and learning curves of several runs."""

import numpy as np
from PIL import Image
from rooms import grid_scene

from dirl.reporting import write_gif
from dirl.reporting.curves import common_frames
from dirl.reporting.maps import never_arrives
from dirl.reporting.pictures import MAX_FRAMES
from dirl.scenes.graph import AHEAD, RIGHT


def test_states_whose_actions_end_in_a_loop_never_arrive():
    scene = grid_scene(3, 2)
    lost = never_arrives(scene, 0, np.full(len(scene), RIGHT))
    assert np.flatnonzero(~lost).tolist() == [0, 1, 2, 3]  # the goal's place, where turning finds its heading
    lost = never_arrives(scene, 12, np.full(len(scene), AHEAD))
    assert np.flatnonzero(~lost).tolist() == [0, 12]
    apart = grid_scene(3, 1, blocked=[(1, 0)])  # from the second place no policy could arrive
    assert not never_arrives(apart, 0, np.full(len(apart), RIGHT)).any()


def test_gif_has_a_frame_for_each_state_up_to_a_limit(tmp_path):
    for path, frames in (([7, 4, 5, 6], 4), ([1, 2, 3, 0] * 50, MAX_FRAMES)):
        write_gif(grid_scene(), 0, path, tmp_path / "e.gif", title="an episode", success=False)
        with Image.open(tmp_path / "e.gif") as image:
            assert image.n_frames == frames


def test_runs_are_compared_where_all_of_them_have_values():
    frames, values = common_frames(
        [(np.array([0.0, 10, 20]), np.array([0.0, 1, 2])), (np.array([5.0, 15]), np.ones(2))]
    )
    assert frames.tolist() == [5, 10, 15]
    assert values.tolist() == [[0.5, 1, 1.5], [1, 1, 1]]
