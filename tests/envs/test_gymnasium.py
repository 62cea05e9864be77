import os

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from dirl.envs import Reward  # which registers dirl/Navigation-v0
from dirl.envs.gymnasium import NavigationGym

NAME = "dirl/Navigation-v0"


@pytest.fixture
def room(dump):
    return {"scene": str(dump), "goal": 0}


def test_gymnasiums_checker_finds_nothing(room):
    env = gymnasium.make(NAME, **room, observation="both", render_mode="rgb_array")
    check_env(env.unwrapped)


def test_the_built_in_room_renders_view_goal_and_map():
    env = gymnasium.make(NAME, scene="bathroom_02", render_mode="rgb_array")
    assert {env.reset(seed=seed)[1]["goal"] for seed in range(60)} == {26, 37, 43, 53, 69}  # drawn among the scene's
    env = gymnasium.make(NAME, scene="bathroom_02", goal=26, render_mode="rgb_array")
    env.reset(options={"state": 3})
    picture = env.render()
    views = env.unwrapped.task.scene.views
    assert picture.dtype == np.uint8
    np.testing.assert_array_equal(picture[:, :400], views[3])
    np.testing.assert_array_equal(picture[:, 400:800], views[26])
    env.step(1)
    assert (env.render()[:, 800:] != picture[:, 800:]).any()  # the agent turned on the map


def test_steps_follow_the_graph_and_earn_the_reward(room, scene):
    env = gymnasium.make(NAME, **room, reward=Reward(goal=5.0, step=-0.5, collision=-2.0))
    for state in np.flatnonzero(scene.distances[:, 0] > 0):
        for action in range(4):
            env.reset(options={"state": int(state)})
            _, reward, terminated, truncated, info = env.step(action)
            after = scene.graph[state, action]
            assert info["collision"] == (after < 0)
            assert info["state"] == (state if after < 0 else after)
            assert info["success"] == terminated == (after == 0)
            assert reward == (-2.0 if after < 0 else 5.0 if after == 0 else -0.5)
            assert not truncated


def test_many_agents_share_the_tables_of_their_scene_until_its_file_changes(room, dump):
    vector = gymnasium.make_vec(NAME, num_envs=3, **room, max_episode_steps=5)
    seen, infos = vector.reset(seed=1)
    assert seen in vector.observation_space
    assert len(set(infos["state"].tolist())) > 1
    ended = [vector.step(np.array([1, 1, 1]))[3] for _ in range(5)]
    assert np.all(ended[-1])
    tasks = {id(env.unwrapped.task) for env in vector.envs}
    os.utime(dump, ns=(1, 1))
    tasks.add(id(gymnasium.make(NAME, **room).unwrapped.task))
    assert len(tasks) == 2


def test_wrong_arguments_actions_and_options_are_refused(room):
    for given, said in (
        ({"observation": "feature"}, "features"),
        ({"scene": "all"}, "name one"),
        ({"goal": 999}, "999"),
    ):
        with pytest.raises(ValueError, match=said):
            NavigationGym(**{**room, **given})
    single = gymnasium.make(NAME, **room).unwrapped
    single.reset()
    for wrong in (-1, np.array([4]), np.array([0, 1]), 1.0, "ahead"):
        with pytest.raises(ValueError, match=r"is not one of 0\.\.3"):
            single.step(wrong)
    single.step(np.array([1]))
    for options in ({"state": 0}, {"goal": 5}, {"start": 1}):
        with pytest.raises(ValueError, match="reset"):
            single.reset(options=options)
