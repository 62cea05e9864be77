"""The navigation task for Gymnasium: ``dirl/Navigation-v0``, one agent; ``gymnasium.make_vec`` makes several.

`import dirl.envs` registers it; this module is imported when one is made. The rules are those of `NavigationEnv`: it
computes every transition once, and from then on a step is a look-up in NumPy arrays, which all environments of a scene
share.
"""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from tensordict import TensorDict

from dirl.envs.navigation import NavigationEnv, Reward
from dirl.envs.rendering import Painter
from dirl.envs.transforms import VIEWS
from dirl.scenes import ACTIONS, SceneError, load_scenes
from dirl.scenes.world import make_world

Ints = NDArray[np.int64]
Observation = dict[str, NDArray[np.float32] | NDArray[np.uint8]]
Facts = dict[str, Any]
"""Gymnasium's ``info``, and the ``options`` of a reset."""


OBSERVED = {"features": ("features",), "views": ("views",), "both": ("features", "views")}
"""What an observation holds: of the agent's surroundings, and with the prefix ``goal_`` of the goal's."""


class Task:
    """One scene of N states and G goals as tables, which all environments of it share.

    Args:
        scene: a built-in room (``bathroom_02``), or the path of a dump file (``.h5``).
        goal: a state of the scene; if None, each reset draws one of the scene's own goals.
        observation: ``features``, ``views`` or ``both``.
        reward: of a step.
        goal_view: ``surrounding``, the four views of the goal; or ``front``, one photo of it (ImageNav). Observations
            of the goal are then ``[1, ...]`` instead of ``[4, ...]``.

    Raises:
        SceneError: the scene or goal does not exist, or the scene has no views.
        ValueError: an unknown ``observation`` or ``goal_view``.
    """

    def __init__(
        self,
        scene: str,
        goal: int | None = None,
        observation: str = "features",
        reward: Reward | None = None,
        goal_view: str = "surrounding",
    ) -> None:
        if goal_view not in ("surrounding", "front"):
            raise ValueError(f"there is no goal_view '{goal_view}'; choose 'surrounding' or 'front'")
        self.goal_views = VIEWS if goal_view == "surrounding" else 1
        if observation not in OBSERVED:
            raise ValueError(f"there is no observation '{observation}'; choose one of {list(OBSERVED)}")
        if scene == "all":
            raise SceneError(f"scene={scene!r}: this environment holds one scene; name one, e.g. scene='bathroom_02'")
        self.observed = OBSERVED[observation]
        (self.scene,) = load_scenes(str(scene))
        if "views" in self.observed and self.scene.views is None:
            raise SceneError(f"{self.scene.origin}: has no views; choose observation='features'")
        if self.scene.features is None and "features" not in self.observed:  # a world has features, needed or not
            self.scene = replace(self.scene, features=np.zeros((len(self.scene), 1), np.float32))
        world = make_world([self.scene], goal)
        states, actions, goals = len(world), len(ACTIONS), len(world.goals)
        self.distances: Ints = world.distances.view(goals, states).long().numpy()
        self.goals: Ints = world.goals.numpy()
        self.surrounding: Ints = world.surrounding.numpy()
        self.features: NDArray[np.float32] = world.features.numpy()
        self.graph: Ints = world.graph.numpy()
        size = (goals, states, actions)
        every = torch.cartesian_prod(*map(torch.arange, size))
        env = NavigationEnv(world, len(every), reward=reward)
        asked = {"goal": world.goals[every[:, 0]], "state": every[:, 1], "action": every[:, 2]}
        asked["scene"] = torch.zeros_like(every[:, 0])
        answer = env.step(TensorDict(asked, batch_size=env.batch_size))["next"]
        self.reward = answer["reward"].view(size).double().numpy()
        self.terminated = answer["terminated"].view(size).numpy()
        self.start_count: Ints = env.start_count.numpy()
        self.starts: list[Ints] = np.split(env.starts.numpy(), self.start_count.cumsum()[:-1])
        self.decoded: dict[int, NDArray[np.uint8]] = {}

    def space(self) -> spaces.Space[Any]:
        """Return the observation space."""
        low, high = self.features.min(), self.features.max()
        by_key: dict[str, spaces.Space[Any]] = {}
        for key, seen in self.observe(0, 0).items():
            if key.endswith("features"):
                by_key[key] = spaces.Box(low, high, seen.shape, np.float32)
            else:
                by_key[key] = spaces.Box(0, 255, seen.shape, np.uint8)
        return spaces.Dict(by_key)

    def draw(self, rng: np.random.Generator) -> tuple[int, int]:
        """Return the goal's index and the start of a new episode, sampled as `NavigationEnv` does."""
        goal = int(rng.integers(len(self.goals)))
        return goal, int(self.starts[goal][rng.integers(self.start_count[goal])])

    def chosen(self, options: Facts, goal: int, state: int) -> tuple[int, int]:
        """Return the goal's index and the start: those that ``options`` name, else those that were sampled."""
        unknown = sorted(set(options) - {"goal", "state"})
        if unknown:
            raise ValueError(f"reset has no option '{unknown[0]}'; options are 'goal' and 'state'")
        if "goal" in options:
            if options["goal"] not in self.goals:
                raise ValueError(f"reset: goal {options['goal']!r} is not among the goals {self.goals.tolist()}")
            goal = int(np.flatnonzero(self.goals == options["goal"])[0])
            state = int(self.starts[goal][state % self.start_count[goal]])
        starts = self.starts[goal]
        if "state" in options:
            state = options["state"]
            if state not in starts:
                raise ValueError(f"reset: state {state!r} is not a start of goal {self.goals[goal]}, see Task.starts")
        return goal, int(state)

    def observe(self, goal: int, state: int) -> Observation:
        """Return what an agent sees: features float32 ``[4, D]``, views uint8 ``[4, H, W, 3]``."""
        observation: Observation = {}
        for prefix, ahead, count in (("", state, VIEWS), ("goal_", self.goals[goal], self.goal_views)):
            around = self.surrounding[ahead, :count]
            for key in self.observed:
                seen = self.features[around] if key == "features" else np.stack([self.view(int(at)) for at in around])
                observation[prefix + key] = seen
        return observation

    def view(self, state: int) -> NDArray[np.uint8]:
        """Return the decoded view of a state, cached; grey if the scene has no views."""
        if state not in self.decoded:
            views = self.scene.views
            self.decoded[state] = np.full((3, 4, 3), 128, np.uint8) if views is None else views[state]
        return self.decoded[state]


@lru_cache(maxsize=4)
def shared_task(scene: str, written: int, **options: Any) -> Task:
    """Return the same `Task` for the same arguments: many environments take the memory of one.

    ``written`` is when the scene's file was, in nanoseconds; 0 if it is none. A dump that was changed is read again.
    """
    del written
    return Task(scene, **options)


class NavigationGym(gymnasium.Env[Observation, np.int64]):
    """One agent on its way to a goal, ``gymnasium.make("dirl/Navigation-v0", scene="bathroom_02")``.

    Actions are 0 ahead, 1 turn right, 2 turn left, 3 back. An episode ends at the goal (place and heading), or after
    200 steps (``max_episode_steps`` of ``gymnasium.make``). Observations are a dictionary of ``features`` and
    ``goal_features`` (float32 ``[4, D]``), ``views`` and ``goal_views`` (uint8 ``[4, H, W, 3]``), or all four: what is
    ahead, right, back and left of the agent, and of the goal. ``info`` holds the ``state``, the ``goal``, the
    ``distance`` to it in actions, ``success`` (arrived by this step) and ``collision`` (the move was blocked).

    ``reset(options={"goal": 26, "state": 3})`` chooses the goal or the start instead of drawing them.

    Args:
        scene: a built-in room, or the path of a dump file.
        render_mode: ``rgb_array``: `render` returns the view, the goal's view and the map side by side; or None.
        task: the further arguments of `Task`: goal, observation, reward, goal_view.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 4}  # noqa: RUF012  as Gymnasium declares it

    def __init__(self, scene: str = "bathroom_02", *, render_mode: str | None = None, **task: Any) -> None:
        self.render_mode = render_mode
        file = Path(scene)
        self.task = shared_task(str(scene), file.stat().st_mtime_ns if file.is_file() else 0, **task)
        self.observation_space = self.task.space()
        self.action_space = spaces.Discrete(len(ACTIONS))
        self._goal = self._state = -1
        self._painter = Painter(self.task.scene, self.task.view)

    def reset(self, *, seed: int | None = None, options: Facts | None = None) -> tuple[Observation, Facts]:
        """Begin an episode; ``seed`` seeds the draws of goals and starts."""
        super().reset(seed=seed)
        self._goal, self._state = self.task.chosen(options or {}, *self.task.draw(self.np_random))
        return self._seen(success=False, collision=False)

    def step(self, action: np.int64) -> tuple[Observation, float, bool, bool, Facts]:
        """Move; raises ValueError for an action that is not 0 to 3, alone or as the one value of an array."""
        if np.size(action) == 1:
            action = np.asarray(action).reshape(-1)[0]
        if not self.action_space.contains(action):
            raise ValueError(f"action {action!r} is not one of 0..{len(ACTIONS) - 1}: {', '.join(ACTIONS)}")
        before = self._goal, self._state, int(action)
        self._state = int(self.task.graph[before[1:]])
        arrived = bool(self.task.terminated[before])
        seen, info = self._seen(success=arrived, collision=self._state == before[1])
        return seen, float(self.task.reward[before]), arrived, False, info

    def _seen(self, **flags: bool) -> tuple[Observation, Facts]:
        task, goal, state = self.task, self._goal, self._state
        distance = int(task.distances[goal, state])
        info = {"state": state, "goal": int(task.goals[goal]), "distance": distance, **flags}
        return task.observe(goal, state), info

    def render(self) -> NDArray[np.uint8] | None:
        """Return the view, the goal's view and the map (agent blue, goal a yellow star), uint8 ``[300, W, 3]``."""
        if self.render_mode is None:
            return None
        return self._painter.paint(int(self.task.goals[self._goal]), self._state)
