"""A live world as a Gymnasium environment, by itself and in TorchRL's wrapper."""

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from torchrl.envs import GymWrapper
from torchrl.envs.utils import check_env_specs

from dirl.envs import Reward
from dirl.envs.live_gymnasium import LiveGym
from dirl.scenes import load_scenes
from dirl.scenes.live import Dumped, Noisy, state_pose


@pytest.fixture(scope="module")
def room():
    return load_scenes("bathroom_02")[0]


@pytest.fixture
def env(room):
    return LiveGym(Dumped(room), room, goal=26)


def test_gymnasiums_checker_finds_nothing(env):
    check_env(env, skip_render_check=True)


def test_the_shortest_path_arrives_and_sees_the_goal(env, room):
    for start in (0, 50, 100):
        seen, info = env.reset(options={"state": start})
        assert info == {"pose": state_pose(room, start), "goal": 26, "success": False, "collision": False}
        state, taken, ended = start, 0, False
        while not ended:
            after = np.where(room.graph[state] < 0, state, room.graph[state])
            action = int(np.argmin(room.distances[after, 26]))
            state, taken = int(after[action]), taken + 1
            seen, reward, ended, truncated, info = env.step(action)
            assert (reward, truncated) == (Reward().goal if ended else Reward().step, False)
        assert taken == room.distances[start, 26]
        assert info["success"]
        assert info["pose"] == state_pose(room, 26)
        assert np.array_equal(seen["views"], seen["goal_views"])


def test_a_blocked_move_is_a_collision(env, room):
    state = int(np.flatnonzero(room.graph[:, 0] < 0)[0])
    env.reset(options={"goal": 26, "state": state})
    _, reward, terminated, _, info = env.step(0)
    assert (reward, terminated, info["collision"]) == (Reward().collision, False, True)
    with pytest.raises(ValueError, match=r"action 4 is not one of 0\.\.3"):
        env.step(4)


def test_torchrl_wraps_it_with_a_limit_of_steps_and_errors_of_moves(room):
    limited = gymnasium.wrappers.TimeLimit(LiveGym(Noisy(Dumped(room), slip=0.2), room), 5)
    env = GymWrapper(limited, categorical_action_encoding=True)
    check_env_specs(env)
    env.set_seed(0)
    torch.manual_seed(0)
    steps = env.rollout(50, break_when_any_done=False)
    assert steps["next", "truncated"].sum() == 10
    assert steps["views"].shape == (50, *env.observation_spec["views"].shape)
