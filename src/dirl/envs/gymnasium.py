"""The navigation task for Gymnasium: ``dirl/Navigation-v0``, one agent or a batch of them.

`import dirl.envs` registers both. The rules are those of `NavigationEnv`: it
computes every transition once, and from then on a step is a look-up in NumPy arrays.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray
from tensordict import TensorDict

from dirl.envs.navigation import NavigationEnv, Reward
from dirl.envs.rendering import Painter
from dirl.envs.transforms import VIEWS
from dirl.scenes import ACTIONS, SceneError, load_scenes, make_world

Ints = NDArray[np.int64]
Observation = dict[str, NDArray[Any]]

OBSERVED = {"features": ("features",), "views": ("views",), "both": ("features", "views")}
"""What an observation holds: of the agent's surroundings, and with the prefix ``goal_`` of the goal's."""

RENDERING = {"render_modes": ["rgb_array"], "render_fps": 4}


class Task:
    """One scene of N states and G goals as tables, which the environments of this module share.

    Args:
        scene: a built-in room (``bathroom_02``), or the path of a dump file (``.h5``).
        source: ``rooms`` for the built-in rooms, ``thor`` for the published dumps, see `dirl.scenes.load_scenes`.
        root: the folder of the published dumps.
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
        source: str = "rooms",
        root: str | Path | None = None,
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
        if scene == "all" or not isinstance(scene, str | Path):
            raise SceneError(f"scene={scene!r}: this environment holds one scene; name one, e.g. scene='bathroom_02'")
        self.observed = OBSERVED[observation]
        (self.scene,) = load_scenes(str(scene), source=source, root=root)
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
        """Return the observation space of one agent."""
        low, high = self.features.min(), self.features.max()
        made: dict[str, spaces.Space[Any]] = {}
        for key, seen in self.observe(np.array(0), np.array(0)).items():
            if key.endswith("features"):
                made[key] = spaces.Box(low, high, seen.shape, np.float32)
            else:
                made[key] = spaces.Box(0, 255, seen.shape, np.uint8)
        return spaces.Dict(made)

    def draw(self, rng: np.random.Generator, count: int) -> tuple[Ints, Ints]:
        """Goal indices and starts of new episodes, int64 ``[count]`` each, sampled as `NavigationEnv` does."""
        goal = rng.integers(len(self.goals), size=count)
        start = rng.integers(self.start_count[goal])
        return goal, np.array([self.starts[one][at] for one, at in zip(goal, start, strict=True)], np.int64)

    def chosen(self, options: dict[str, Any], goal: int, state: int) -> tuple[int, int]:
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

    def observe(self, goal: Ints, state: Ints) -> Observation:
        """Return the agents' observations: features float32 ``[..., 4, D]``, views uint8 ``[..., 4, H, W, 3]``."""
        made: Observation = {}
        for prefix, at, count in (("", state, VIEWS), ("goal_", self.goals[goal], self.goal_views)):
            around = self.surrounding[at][..., :count]
            for key in self.observed:
                if key == "features":
                    made[prefix + key] = self.features[around]
                else:
                    views = np.stack([self.view(int(seen)) for seen in around.flat])
                    made[prefix + key] = views.reshape(*around.shape, *views.shape[1:])
        return made

    def view(self, state: int) -> NDArray[np.uint8]:
        """Return the decoded view of a state, cached; grey if the scene has no views."""
        if state not in self.decoded:
            views = self.scene.views
            self.decoded[state] = np.full((3, 4, 3), 128, np.uint8) if views is None else views[state]
        return self.decoded[state]


def _check_render_mode(render_mode: str | None) -> None:
    if render_mode not in (None, "rgb_array"):
        raise ValueError(f"there is no render_mode {render_mode!r}; choose 'rgb_array' or None")


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
        task: the further arguments of `Task`: source, root, goal, observation, reward.
    """

    metadata: dict[str, Any] = RENDERING

    def __init__(self, scene: str = "bathroom_02", *, render_mode: str | None = None, **task: Any) -> None:
        _check_render_mode(render_mode)
        self.render_mode = render_mode
        self.task = Task(scene, **task)
        self.observation_space = self.task.space()
        self.action_space = spaces.Discrete(len(ACTIONS))
        self._goal = self._state = -1
        self._painter = Painter(self.task.scene, self.task.view)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode; ``seed`` seeds the draws of goals and starts."""
        super().reset(seed=seed)
        goal, state = self.task.draw(self.np_random, 1)
        self._goal, self._state = self.task.chosen(options or {}, int(goal[0]), int(state[0]))
        return self._seen(success=False, collision=False)

    def step(self, action: np.int64) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Move; raises ValueError for an action that is not 0 to 3, alone or as the one value of an array."""
        self._check_begun("step")
        if np.size(action) == 1:
            action = np.asarray(action).reshape(-1)[0]
        if not self.action_space.contains(action):
            raise ValueError(f"action {action!r} is not one of 0..{len(ACTIONS) - 1}: {', '.join(ACTIONS)}")
        before = self._goal, self._state, int(action)
        self._state = int(self.task.graph[before[1:]])
        arrived = bool(self.task.terminated[before])
        seen, info = self._seen(success=arrived, collision=self._state == before[1])
        return seen, float(self.task.reward[before]), arrived, False, info

    def _seen(self, **flags: bool) -> tuple[Observation, dict[str, Any]]:
        task, goal, state = self.task, self._goal, self._state
        distance = int(task.distances[goal, state])
        info = {"state": state, "goal": int(task.goals[goal]), "distance": distance, **flags}
        return task.observe(np.array(goal), np.array(state)), info

    def render(self) -> NDArray[np.uint8] | None:
        """Return the view, the goal's view and the map (agent blue, goal a yellow star), uint8 ``[300, W, 3]``."""
        self._check_begun("render")
        if self.render_mode is None:
            return None
        return self._painter.paint(int(self.task.goals[self._goal]), self._state)

    def _check_begun(self, what: str) -> None:
        if self._state < 0:
            raise ValueError(f"{what}: there is no episode yet; call reset() first")


class NavigationVector(VectorEnv[Observation, Ints, NDArray[Any]]):
    """Many agents in one scene, ``gymnasium.make_vec("dirl/Navigation-v0", num_envs=64, scene="bathroom_02")``.

    As `NavigationGym`, with a batch dimension: a step of all agents is one look-up. An agent whose episode ended begins
    the next one in the following step, whatever its action (``AutoresetMode.NEXT_STEP``).

    Args:
        scene: a built-in room, or the path of a dump file.
        num_envs: B, how many agents.
        max_episode_steps: number of steps after which an episode is truncated; None for no limit.
        render_mode: ``rgb_array``: `render` returns one picture for each agent; or None.
        task: the further arguments of `Task`: source, root, goal, observation, reward.
    """

    metadata: dict[str, Any] = {**RENDERING, "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012  as Gymnasium declares it

    def __init__(
        self,
        scene: str = "bathroom_02",
        *,
        num_envs: int = 1,
        max_episode_steps: int | None = None,
        render_mode: str | None = None,
        **task: Any,
    ) -> None:
        _check_render_mode(render_mode)
        self.render_mode, self.num_envs, self.max_episode_steps = render_mode, num_envs, max_episode_steps
        self.task = Task(scene, **task)
        self.single_observation_space, self.single_action_space = self.task.space(), spaces.Discrete(len(ACTIONS))
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._goal, self._state, self._steps = np.zeros((3, num_envs), np.int64)
        self._ended = np.zeros(num_envs, bool)
        self._painter = Painter(self.task.scene, self.task.view)

    def reset(
        self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode of every agent; ``seed``, a number or one for each, determines all draws.

        There are no ``options``.
        """
        if isinstance(seed, Sequence | np.ndarray):
            self.np_random = np.random.default_rng([int(number) for number in seed])
        else:
            super().reset(seed=seed)
        if options:
            raise ValueError(f"reset of a vector environment has no options, found {sorted(options)}")
        self._begin(np.ones(self.num_envs, bool))
        return self._seen(self._ended.copy(), self._ended.copy())

    def step(self, actions: Ints) -> tuple[Observation, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Move every agent; ``actions`` are integers 0 to 3, ``[B]``, else ValueError."""
        actions = np.asarray(actions)
        whole = actions.shape == (self.num_envs,) and np.issubdtype(actions.dtype, np.integer)
        if not whole or ((actions < 0) | (actions >= len(ACTIONS))).any():
            raise ValueError(f"actions: expected {self.num_envs} integers 0..{len(ACTIONS) - 1}, found {actions!r}")
        begins, before = self._ended, self._state
        taken = self._goal, before, actions
        reward = np.where(begins, 0.0, self.task.reward[taken])
        arrived = self.task.terminated[taken] & ~begins
        self._state = self.task.graph[before, actions]
        collided = (self._state == before) & ~begins
        self._steps = self._steps + 1
        self._begin(begins)
        limit = np.inf if self.max_episode_steps is None else self.max_episode_steps
        truncated = self._steps >= limit
        self._ended = arrived | truncated
        observation, info = self._seen(arrived.copy(), collided)
        return observation, reward, arrived, truncated, info

    def _begin(self, agents: NDArray[np.bool_]) -> None:
        self._goal[agents], self._state[agents] = self.task.draw(self.np_random, int(agents.sum()))
        self._steps[agents] = 0
        self._ended = self._ended & ~agents

    def _seen(self, success: NDArray[np.bool_], collision: NDArray[np.bool_]) -> tuple[Observation, dict[str, Any]]:
        task, goal, state = self.task, self._goal, self._state
        info: dict[str, Any] = {
            "state": state.copy(),
            "goal": task.goals[goal],
            "distance": task.distances[goal, state],
        }
        info.update(success=success, collision=collision)
        # In Gymnasium's convention _<key> marks the agents that have <key>: here, all of them.
        info.update({f"_{key}": np.ones(self.num_envs, bool) for key in list(info)})
        return task.observe(goal, state), info

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Return the picture of each agent, see `NavigationGym.render`."""
        if self.render_mode is None:
            return None
        goals = self.task.goals[self._goal]
        return tuple(self._painter.paint(int(goal), int(state)) for goal, state in zip(goals, self._state, strict=True))
