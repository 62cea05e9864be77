"""The navigation task in a simulator: moves are the simulator's own, and views are rendered when they are seen.

One simulator serves all agents in turn, so that new views of all of them go through the encoder together, and a pose
that returns is neither rendered nor encoded again. (TorchRL's ``GymWrapper`` would need a simulator for each agent.)
"""

from collections import OrderedDict
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Categorical, Unbounded

from dirl.envs.navigation import NavigationEnv
from dirl.envs.transforms import VIEWS, front_only
from dirl.scenes.graph import AHEAD, BACK, RIGHT, turns_per_circle
from dirl.scenes.live import Pose, Simulator, shortest_move, simulator_errors, stride
from dirl.scenes.world import World

QUARTERS = (0.0, 90.0, 180.0, 270.0)
SNAP = 0.02
"""Metres, and degrees, from a place of the dump at which the agent counts as exactly there."""

MOVES = 100_000
"""Moves at most whose end poses are remembered."""

Key = tuple[float, float, float]
"""A view: x and z in millimetres, heading in tenths of a degree."""


class LiveEnv(NavigationEnv):
    """Agents that walk in a simulator.

    An observation holds what that of `NavigationEnv` does, and

    - ``pose``: x, z in metres and the heading in degrees, float64 ``[B, 3]``;
    - ``view_ids``, ``goal_view_ids``: rows of the table in which the features of the four views are, int64 ``[B, 4]``.

    The dump of the simulator gives goals, starts and distances; ``state`` is the nearest one to the pose. Of the views
    the last ``views`` are remembered, by their poses to a millimetre and a tenth of a degree.

    It takes what `NavigationEnv` does, with a world of one scene, the dump of the simulator, and:

    Args:
        simulator: in which the agents take turns.
        encode: images, uint8 ``[R, H, W, 3]``, to backbone outputs ``[R, D + patches]``.
        table: a `dirl.models.FeatureTable`, which gets what is encoded and has room for it.
        turn_error: standard deviation of each turn, degrees; with it hardly any view returns.
        views: how many are remembered.
        front: show the goals' front view alone.
    """

    def __init__(
        self,
        world: World,
        num_agents: int = 1,
        *,
        simulator: Any,  # a `Simulator`, of which an option holds the file
        encode: Callable[[Tensor], Tensor],
        table: Any,
        turn_error: float = 0.0,
        views: int = 20_000,
        front: bool = False,
        **walking: Any,
    ) -> None:
        if turn_error < 0:
            raise ValueError(f"turn_error={turn_error}: is a standard deviation, at least 0")
        super().__init__(world, num_agents, **walking)
        scene = world.scenes[0]
        self.simulator: Simulator = simulator
        self.encode, self.table, self.front = encode, table, front
        self.turn_error, self.remembered = turn_error, views
        self.step_metres, self.turn = shortest_move(scene), 360 / turns_per_circle(scene.graph)
        places = np.column_stack([scene.positions, scene.headings]).astype(np.float64)
        self.places = torch.from_numpy(places).to(world.device)
        self.rows: OrderedDict[Key, int] = OrderedDict()
        """Table rows of the remembered views, in the order in which they were seen last."""
        self._pushed = lru_cache(MOVES)(self._push)
        agents = self.batch_size
        seen = (*agents, VIEWS)
        self.observation_spec["pose"] = Unbounded((*agents, 3), dtype=torch.float64, device=self.device)
        for key in ("view_ids", "goal_view_ids"):
            self.observation_spec[key] = Categorical(len(table.table), shape=seen, device=self.device)

    def _reset(self, tensordict: TensorDictBase | None = None, **_: object) -> TensorDictBase:
        agents = super()._reset(tensordict)
        pose = self.places[agents["state"]]
        return agents.set("pose", pose).update(self._seen(pose, agents["goal"]))

    def restore_agents(self, agents: TensorDictBase) -> TensorDictBase:
        """Return the agents with what they see, which is encoded anew: no checkpoint holds it."""
        self.rows.clear()
        return agents.update(self._seen(agents["pose"], agents["goal"]))

    def _move(self, tensordict: TensorDictBase) -> dict[str, Tensor]:
        """Return where the agents are after their actions, and what they see there."""
        slipped = self._slipped() if self.slip else torch.zeros_like(tensordict["action"], dtype=torch.bool)
        errors = torch.zeros(self.batch_size, device=self.device)
        if self.turn_error:
            errors = self.turn_error * torch.randn(self.batch_size, generator=self.generator, device=self.device)
        taken = (tensordict["pose"], tensordict["state"], tensordict["action"], errors, slipped)
        after = [
            pose if slips else self._after(pose, float(self.places[state, 2]), action, error)
            for pose, state, action, error, slips in zip(*(values.tolist() for values in taken), strict=True)
        ]
        pose = torch.tensor(after, dtype=torch.float64, device=self.device)
        # The nearest place, and there the nearest heading.
        away = torch.cdist(pose[:, :2], self.places[:, :2])
        state = torch.argmin(away + 1e-6 * _turned(pose[:, None], self.places), 1)
        at = self.places[state]
        near = (torch.linalg.vector_norm(pose[:, :2] - at[:, :2], dim=1) < SNAP) & (_turned(pose, at) < SNAP)
        pose = torch.where(near[:, None], at, pose)
        return {"state": state, "pose": pose, **self._seen(pose, tensordict["goal"])}

    def _after(self, pose: list[float], intended: float, action: int, error: float) -> list[float]:
        """Return where an action leads from a pose, by an agent that takes its heading for the ``intended`` one."""
        x, z, heading = pose
        if action in (AHEAD, BACK):
            metres = stride(intended, self.step_metres)
            return list(self._pushed(x, z, heading, metres if action == AHEAD else -metres)) if metres else pose
        return [x, z, (heading + (self.turn if action == RIGHT else -self.turn) + error) % 360]

    def _push(self, x: float, z: float, heading: float, metres: float) -> Pose:
        with simulator_errors(self.simulator.name):
            self.simulator.place(Pose(x, z, heading))
            self.simulator.push(metres)
            return Pose(*self.simulator.pose)

    def _seen(self, pose: Tensor, goal: Tensor) -> dict[str, Tensor]:
        """Return the rows of the views at poses, float64 ``[B, 3]``, and at goals."""
        goals, which = goal.unique(return_inverse=True)
        rows = self._rows([*pose.tolist(), *self.places[goals].tolist()])
        shown = rows[len(pose) :]
        shown = front_only(shown, len(self.table)) if self.front else shown
        return {"view_ids": rows[: len(pose)], "goal_view_ids": shown[which]}

    def _rows(self, poses: list[list[float]]) -> Tensor:
        """Return the rows of the four views of each pose, int64 ``[R, 4]``; new views are encoded all together."""
        views = [(x, z, (heading + quarter) % 360) for x, z, heading in poses for quarter in QUARTERS]
        keys = [(round(x, 3), round(z, 3), round(heading, 1) % 360) for x, z, heading in views]
        new = {key: view for key, view in zip(keys, views, strict=True) if key not in self.rows}
        for key in keys:
            if key in self.rows:
                self.rows.move_to_end(key)
        if new:
            images = torch.from_numpy(self._render(list(new.values()))).to(self.device)
            for key in new:
                free = len(self.table) + 1 + len(self.rows)
                self.rows[key] = free if len(self.rows) < self.remembered else self.rows.popitem(last=False)[1]
            self.table.write(torch.tensor([self.rows[key] for key in new], device=self.device), self.encode(images))
        return torch.tensor([self.rows[key] for key in keys], device=self.device).unflatten(0, (-1, VIEWS))

    def _render(self, views: list[tuple[float, float, float]]) -> NDArray[np.uint8]:
        images, at = [], None
        with simulator_errors(self.simulator.name):
            for x, z, heading in views:
                if (x, z) != at:
                    self.simulator.place(Pose(x, z, heading))
                    at = (x, z)
                images.append(self.simulator.look(heading))
        return np.stack(images)


def _turned(pose: Tensor, other: Tensor) -> Tensor:
    """Return the degrees between the headings of poses, float64."""
    return ((pose[..., 2] - other[..., 2] + 180) % 360 - 180).abs()
