"""The navigation task and what an agent observes in it."""

import gymnasium

import dirl.envs.start_method  # noqa: F401  before any module that imports TorchRL
from dirl.envs.navigation import NavigationEnv, Reward
from dirl.envs.transforms import SequentialViews, SurroundingViews, ViewFeatures

gymnasium.register(id="dirl/Navigation-v0", entry_point="dirl.envs.gymnasium:NavigationGym", max_episode_steps=200)

__all__ = ["NavigationEnv", "Reward", "SequentialViews", "SurroundingViews", "ViewFeatures"]
