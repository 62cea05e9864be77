"""What an agent sees: four views, of its surroundings or of its last four steps, as the states they belong to.

Both transforms turn ``state`` and ``goal`` into ``views`` and ``goal_views``, int64 ``[..., 4]``. The views stay
state numbers: only the encoder looks up the features behind them. Both work on an environment and on a replay buffer.
"""

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Categorical, TensorSpec
from torchrl.envs import Transform

from dirl.scenes import World

VIEWS = 4


class SurroundingViews(Transform):
    """The views ahead, right, back and left of the agent's heading, and those of the goal (paper section 3.5).

    Args:
        world: where the agents walk.
    """

    history = False
    """Whether what is seen depends on more than where the agent is."""

    def __init__(self, world: World) -> None:
        super().__init__(in_keys=["state", "goal"], out_keys=["views", "goal_views"])
        self.states = len(world)
        self.register_buffer("surrounding", world.surrounding)

    def begin(self, state: Tensor) -> Tensor:
        """What is seen at the start of an episode, and of a goal, int64 ``[...]`` to ``[..., 4]``."""
        return self.surrounding[state]

    def follow(self, views: Tensor, state: Tensor) -> Tensor:
        """What is seen after a step to ``state``, int64 ``[...]``, where ``views`` ``[..., 4]`` were seen before it."""
        return self.begin(state)

    def _apply_transform(self, state: Tensor) -> Tensor:
        return self.begin(state)

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return self._call(tensordict_reset)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        next_tensordict["views"] = self.follow(tensordict["views"], next_tensordict["state"])
        next_tensordict["goal_views"] = tensordict["goal_views"]
        return next_tensordict

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add ``views`` and ``goal_views``."""
        shape = (*observation_spec.shape, VIEWS)
        for key in self.out_keys:
            observation_spec[key] = Categorical(self.states, shape=shape, device=observation_spec.device)
        return observation_spec


class SequentialViews(SurroundingViews):
    """The views of the last four steps, the newest last; the goal's view four times (TD-DRL, Zhu et al. 2017).

    At the start of an episode the first view stands four times. The history lies in the tensordict itself (TorchRL's
    ``CatFrames`` keeps it in the transform), so that an agent's tensordict is all there is to save.

    On a replay buffer the sampled tensordict must be ``[..., T]``, steps of consecutive time; its first step is taken
    as the start of an episode.
    """

    history = True

    def begin(self, state: Tensor) -> Tensor:
        """The state four times, int64 ``[...]`` to ``[..., 4]``."""
        return state.unsqueeze(-1).expand(*state.shape, VIEWS).clone()

    def follow(self, views: Tensor, state: Tensor) -> Tensor:
        """``views`` without the oldest, and the new state, int64 ``[..., 4]``."""
        return torch.cat([views[..., 1:], state.unsqueeze(-1)], -1)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``views`` and ``goal_views`` of a replayed batch, see the class."""
        state = tensordict["state"]
        views = self.begin(state)
        for time in range(1, state.shape[-1]):
            begins = tensordict["next", "done"][..., time - 1, :]
            longer = self.follow(views[..., time - 1, :], state[..., time])
            views[..., time, :] = torch.where(begins, views[..., time, :], longer)
        tensordict["views"] = views
        tensordict["goal_views"] = self.begin(tensordict["goal"])
        return tensordict


OBSERVATIONS = {"surrounding": SurroundingViews, "sequential": SequentialViews}
"""The transforms by the names they have in a configuration."""
