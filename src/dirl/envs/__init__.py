"""The navigation task and what an agent observes in it."""

import dirl.envs.start_method  # noqa: F401  before any module that imports TorchRL
from dirl.envs.navigation import NavigationEnv, Reward
from dirl.envs.transforms import SequentialViews, SurroundingViews, ViewFeatures

__all__ = ["NavigationEnv", "Reward", "SequentialViews", "SurroundingViews", "ViewFeatures"]
