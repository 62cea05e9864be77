"""A live world for Gymnasium, and so for TorchRL's ``GymWrapper``: one agent that sees views as they are made."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from dirl.envs.navigation import Reward
from dirl.scenes import ACTIONS, Scene
from dirl.scenes.graph import turns_per_circle
from dirl.scenes.live import Image, LiveWorld, arrived, shortest_move, state_pose


class LiveGym(gymnasium.Env[dict[str, Image], np.int64]):
    """One agent on its way to a goal in a live world, as `dirl.envs.gymnasium.NavigationGym` is in a dump.

    Observations are ``views`` and ``goal_views``, uint8 ``[4, H, W, 3]``: what is ahead, right, back and left of the
    agent, and of the goal. Actions are 0 ahead, 1 turn right, 2 turn left, 3 back. An episode ends at the goal, with a
    heading nearer to the goal's than to that of a neighbouring state; it has no limit of steps. ``info`` holds the
    ``pose``, the ``goal``, ``success`` (arrived by this step) and ``collision`` (the agent stayed where it was).

    ``reset(options={"goal": 26, "state": 3})`` chooses the goal or the start instead of drawing them.

    Args:
        world: to walk in, see `dirl.scenes.live`.
        scene: with the coordinates of the world; gives goals and starts.
        goal: a state of the scene; if None, each reset draws one of the scene's own goals, or of its states.
        reward: of a step.
        within: metres from the goal at which an agent has arrived; half of the shortest move if left out.
    """

    def __init__(
        self,
        world: LiveWorld,
        scene: Scene,
        *,
        goal: int | None = None,
        reward: Reward | None = None,
        within: float | None = None,
    ) -> None:
        self.world, self.scene, self.reward = world, scene, reward or Reward()
        self.goals = [goal] if goal is not None else list(scene.goals) or list(range(len(scene)))
        self.within = shortest_move(scene) / 2 if within is None else within
        self.degrees = 180 / turns_per_circle(scene.graph)
        seen = spaces.Box(0, 255, world.views().shape, np.uint8)
        self.observation_space: spaces.Space[Any] = spaces.Dict({"views": seen, "goal_views": seen})
        self.action_space = spaces.Discrete(len(ACTIONS))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Image], dict[str, Any]]:
        """Begin an episode; ``seed`` seeds the draws of goals and starts."""
        super().reset(seed=seed)
        chosen = options or {}
        self._goal = int(chosen.get("goal", self.np_random.choice(self.goals)))
        starts = np.flatnonzero(self.scene.distances[:, self._goal] > 0)
        start = int(chosen.get("state", self.np_random.choice(starts)))
        self.world.reset(state_pose(self.scene, self._goal))
        self._goal_views = self.world.views()
        self.world.reset(state_pose(self.scene, start))
        return self._seen(success=False, collision=False)

    def step(self, action: np.int64) -> tuple[dict[str, Image], float, bool, bool, dict[str, Any]]:
        """Move; raises ValueError for an action that is not 0 to 3."""
        if not self.action_space.contains(action):
            raise ValueError(f"action {action!r} is not one of 0..{len(ACTIONS) - 1}: {', '.join(ACTIONS)}")
        moved = self.world.step(int(action))
        success = arrived(self.world.pose, state_pose(self.scene, self._goal), self.within, self.degrees)
        reward = self.reward.goal if success else self.reward.step if moved else self.reward.collision
        observation, info = self._seen(success=success, collision=not moved)
        return observation, reward, success, False, info

    def _seen(self, **flags: bool) -> tuple[dict[str, Image], dict[str, Any]]:
        observation = {"views": self.world.views(), "goal_views": self._goal_views.copy()}
        return observation, {"pose": self.world.pose, "goal": self._goal, **flags}
