"""Demonstrations for many goals: pairs of a state and a goal, sampled for each update."""

import copy
from typing import TypeAlias

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from dirl.agent.decisions import observe
from dirl.envs import SurroundingViews
from dirl.envs.transforms import front_only
from dirl.evaluation.episodes import drawn_looks
from dirl.evaluation.experts import label, merge_demonstrations
from dirl.scenes.world import World


class DrawnPairs:
    """The expert's actions for pairs of a state and a goal, sampled anew for every update.

    A table of all pairs grows with the square of the states. A draw takes a goal uniformly among all, then a state of
    its scene. In a world that changes the goal is seen in one look and the state in another, both sampled.

    Args:
        world: where to walk; its goals are those of the pairs.
        expert: see `dirl.evaluation.experts.ShortestPathExpert`.
        observation: what is observed. States have no history: they are observed as the start of an episode.
        shown: which states the expert shows, bool ``[N]``.
        scenes_at_once: of how many scenes, sampled anew, the pairs of an update are, so that few observations are
            embedded for it where there are hundreds of scenes; all of them if None.
        front_only: the fraction of pairs whose goal is given by its front view alone, so that a policy learns both.
    """

    def __init__(
        self,
        world: World,
        expert: TensorDictModuleBase,
        observation: SurroundingViews,
        shown: Tensor,
        front_only: float = 0.0,
        scenes_at_once: int | None = None,
    ) -> None:
        self.world, self.expert, self.observation = world, expert, observation
        self.front_only, self.scenes_at_once = front_only, scenes_at_once
        self.visited: TensorDictBase | None = None
        """Labelled states that the learner came to, ``[M]``; half of each draw is taken from them (DAgger)."""
        self.states = torch.nonzero(shown).flatten()
        self.count = torch.bincount(world.scene_of[self.states], minlength=len(world.scenes))
        self.first = self.count.cumsum(0) - self.count
        self.goals = torch.bincount(world.scene_of[world.goals], minlength=len(world.scenes))
        self.first_goal = self.goals.cumsum(0) - self.goals

    def __len__(self) -> int:
        """Return how many pairs there are."""
        return int((self.goals * self.count).sum())

    def draw(self, size: int) -> TensorDictBase:
        """Return up to ``size`` demonstrations; pairs for which the expert has no advice are left out."""
        world, observation, device = self.world, self.observation, self.world.device
        old = 0 if self.visited is None else size // 2
        goal_index = self._goals(size - old)
        scene = world.scene_of[world.goals[goal_index]]
        state = self.states[self.first[scene] + (torch.rand(len(scene), device=device) * self.count[scene]).long()]
        wanted = drawn_looks(goal_index, len(world.goals), world)
        ahead = drawn_looks(state, len(world), world, besides=wanted // len(world.goals))
        rows = label(self.expert, observe(world, observation, ahead, observation.reset_view_ids(ahead), wanted))
        if self.visited is not None:
            rows = torch.cat([rows, self.visited[torch.randint(len(self.visited), (old,), device=device)]])
        if self.front_only:
            photo = torch.rand((len(rows), 1), device=device) < self.front_only
            views = rows["goal_view_ids"]
            rows["goal_view_ids"] = torch.where(photo, front_only(views, observation.pictures), views)
        return rows

    def _goals(self, size: int) -> Tensor:
        """Draw places among the world's goals, int64 ``[size]``."""
        if self.scenes_at_once is None or self.scenes_at_once >= len(self.goals):
            return torch.randint(len(self.world.goals), (size,), device=self.world.device)
        scenes = torch.multinomial(self.goals.float(), self.scenes_at_once)  # the more goals, the more often
        scene = scenes[torch.randint(len(scenes), (size,), device=scenes.device)]
        return self.first_goal[scene] + (torch.rand(size, device=scene.device) * self.goals[scene]).long()


Demonstrations: TypeAlias = TensorDictBase | DrawnPairs
"""Rows ``[M]``, see `dirl.evaluation.experts.demonstrations`, or pairs that are sampled."""


def with_labels(demonstrations: Demonstrations, rows: TensorDictBase) -> Demonstrations:
    """Join demonstrations and labelled states that the learner came to, ``[M]`` (DAgger)."""
    if not isinstance(demonstrations, DrawnPairs):
        return merge_demonstrations(demonstrations, rows)
    merged = copy.copy(demonstrations)
    merged.visited = rows if merged.visited is None else torch.cat([merged.visited, rows])
    return merged
