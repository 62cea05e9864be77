"""The navigation task and what an agent observes in it."""

from dirl.envs.navigation import NavigationEnv, Reward
from dirl.envs.transforms import SequentialViews, SurroundingViews, ViewFeatures

__all__ = ["NavigationEnv", "Reward", "SequentialViews", "SurroundingViews", "ViewFeatures"]
