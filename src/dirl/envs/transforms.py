"""Observations as transforms: the ids of four views, of the surroundings or of the last four steps.

`SurroundingViews` and `SequentialViews` turn ``state`` and ``goal`` into ``view_ids`` and ``goal_view_ids``, int64
``[..., 4]``: the states that the views belong to. The network looks up the features behind them. `ViewFeatures` looks
them up in the environment instead, for networks that read features.
"""

from typing import Literal

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Categorical, TensorSpec, Unbounded
from torchrl.envs import Transform

from dirl.scenes.world import World

VIEWS = 4
"""Number of views around an agent: ahead, right, back and left."""


class SurroundingViews(Transform):
    """The views ahead, right, back and left of the agent's heading, and those of the goal (paper section 3.5).

    Args:
        world: where the agents walk.
        goal_view: ``surrounding``, all four views of the goal; or ``front``, only the one ahead, as in a photo
            (ImageNav). The ids of the other three are the number of states, which denotes no view.
    """

    history = False
    """True if an observation depends on earlier states too."""

    order: tuple[str, ...] = ("ahead", "right", "back", "left")
    """The names of the views, as many as an observation has; they are saved in checkpoints."""

    def __init__(self, world: World, goal_view: Literal["surrounding", "front"] = "surrounding") -> None:
        super().__init__(in_keys=["state", "goal"], out_keys=["view_ids", "goal_view_ids"])
        self.states = len(world)
        self.pictures = world.looks * len(world)
        """How many pictures there are; as a view id, this number denotes no view."""
        self.goal_view = goal_view
        by_look = [world.surrounding + look * len(world) for look in range(world.looks)]
        self.register_buffer("surrounding", torch.cat(by_look))

    def reset_view_ids(self, picture: Tensor) -> Tensor:
        """Return the view ids at the start of an episode, int64 ``[...]`` to ``[..., 4]``.

        A picture is what is seen ahead, ``look * N + state``: the state itself in a world that never changes.
        """
        return self.surrounding[picture]

    def goal_view_ids(self, picture: Tensor) -> Tensor:
        """Return the view ids of a goal, int64 ``[...]`` to ``[..., 4]``, see `reset_view_ids`."""
        views = self.reset_view_ids(picture)
        return views if self.goal_view == "surrounding" else front_only(views, self.pictures)

    def step_view_ids(self, view_ids: Tensor, picture: Tensor) -> Tensor:
        """Return the view ids after a step to where ``picture`` is seen, int64 ``[...]``, given those before it."""
        return self.reset_view_ids(picture)

    # A world that never changes samples no looks: all are in look 0.

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        picture = tensordict_reset["state"] + self.states * tensordict_reset.get("look", 0)
        goal_picture = tensordict_reset["goal"] + self.states * tensordict_reset.get("goal_look", 0)
        tensordict_reset["view_ids"] = self.reset_view_ids(picture)
        tensordict_reset["goal_view_ids"] = self.goal_view_ids(goal_picture)
        return tensordict_reset

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        picture = next_tensordict["state"] + self.states * next_tensordict.get("look", 0)
        next_tensordict["view_ids"] = self.step_view_ids(tensordict["view_ids"], picture)
        next_tensordict["goal_view_ids"] = tensordict["goal_view_ids"]
        return next_tensordict

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add ``view_ids`` and ``goal_view_ids``."""
        shape = (*observation_spec.shape, len(self.order))
        own = type(self) not in (SurroundingViews, SequentialViews)  # one of your own may hide any view
        unknown = {"view_ids": own, "goal_view_ids": own or self.goal_view == "front"}
        for key, hidden in unknown.items():
            observation_spec[key] = Categorical(self.pictures + hidden, shape=shape, device=observation_spec.device)
        return observation_spec


def front_only(views: Tensor, unknown: int) -> Tensor:
    """Return the first of the views, int64 ``[..., 4]``; the others are ``unknown``."""
    return torch.where(torch.arange(views.shape[-1], device=views.device) == 0, views, unknown)


def broken_promise(own: SurroundingViews) -> str | None:
    """Return why a transform of one's own would silently be learnt wrongly; None if it keeps its contract.

    Demonstrations, caches and evaluation call `reset_view_ids`; the environment also calls `step_view_ids`.
    """
    every = torch.arange(own.pictures, device=own.surrounding.device)
    seen = own.reset_view_ids(every)
    if seen.shape != (len(every), len(own.order)):
        return f"reset_view_ids gives {list(seen.shape)} for {len(every)} pictures; order names {len(own.order)} views"
    if not torch.equal(seen, own.reset_view_ids(every)):
        return "reset_view_ids gives other views of a picture each time it is called"
    if not own.history and not torch.equal(own.step_view_ids(seen.roll(1, 0), every), seen):
        return "step_view_ids gives other views than reset_view_ids, so set history = True"
    return None


class SequentialViews(SurroundingViews):
    """The views of the last four steps, the newest last; the goal's view four times (TD-DRL, Zhu et al. 2017).

    At the start of an episode the first view is repeated four times. The history is in the tensordict itself (TorchRL's
    ``CatFrames`` keeps it in the transform), so that the tensordict is the complete state of an agent.
    """

    history = True

    def __init__(self, world: World) -> None:
        super().__init__(world)

    order = ("three steps ago", "two steps ago", "one step ago", "now")

    def reset_view_ids(self, picture: Tensor) -> Tensor:
        """Return the picture four times, int64 ``[...]`` to ``[..., 4]``."""
        return picture.unsqueeze(-1).expand(*picture.shape, len(self.order)).clone()

    def step_view_ids(self, view_ids: Tensor, picture: Tensor) -> Tensor:
        """Return ``view_ids`` without the oldest, and the new picture, int64 ``[..., 4]``."""
        return torch.cat([view_ids[..., 1:], picture.unsqueeze(-1)], -1)


class ViewFeatures(Transform):
    """The features behind view ids, as ``observation`` and ``goal_observation``, float32 ``[..., 4, D]``.

    Args:
        table: features of all N pictures, float32 ``[N, D]``. View id N, an unknown view, has zeros.
    """

    def __init__(self, table: Tensor) -> None:
        super().__init__(in_keys=["view_ids", "goal_view_ids"], out_keys=["observation", "goal_observation"])
        self.register_buffer("table", torch.cat([table, table.new_zeros(1, table.shape[1])]))

    def _apply_transform(self, view_ids: Tensor) -> Tensor:
        return self.table[view_ids]

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return self._call(tensordict_reset)

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add ``observation`` and ``goal_observation``."""
        for ids, key in zip(self.in_keys, self.out_keys, strict=True):
            shape = (*observation_spec[ids].shape, self.table.shape[1])
            observation_spec[key] = Unbounded(shape, device=observation_spec.device, dtype=self.table.dtype)
        return observation_spec
