"""The navigation task and what an agent sees in it."""

from dirl.envs.navigation import NavigationEnv, Reward
from dirl.envs.transforms import OBSERVATIONS, SequentialViews, SurroundingViews

__all__ = ["OBSERVATIONS", "NavigationEnv", "Reward", "SequentialViews", "SurroundingViews"]
