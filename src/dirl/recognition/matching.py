"""Template matching: recognising that the goal has been reached (paper section 3.4)."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from dirl.scenes.world import World

FRONT_THRESHOLD = 0.95
"""Above which one photo matches: other places are more like a goal in one view than in four, see docs/decisions.md."""


def ncc(observation: Tensor, goal: Tensor) -> Tensor:
    """Normalised cross-correlation of feature vectors, i.e. Pearson's coefficient (paper equation 13).

    Args:
        observation: float ``[..., D]``.
        goal: float ``[..., D]``, broadcast against it.

    Returns:
        float ``[...]`` in [-1, 1]; 0 where one of the vectors is constant.
    """
    return (normal_vectors(observation) * normal_vectors(goal)).sum(-1)


def normal_vectors(vector: Tensor) -> Tensor:
    """Vectors, float ``[..., D]``, without their mean and of length one; the product of two is their `ncc`."""
    centred = vector - vector.mean(-1, keepdim=True)
    # The mean of a constant vector is rounded; the remainder must not be normalised to length one.
    constant = vector.amax(-1, keepdim=True) == vector.amin(-1, keepdim=True)
    return F.normalize(centred.masked_fill(constant, 0.0), dim=-1)


def template_vectors(features: Tensor, surrounding: Tensor, match: str) -> Tensor:
    """The compared vector of each state, scaled so that the product of two is their coefficient, float32 ``[N, D']``.

    Args:
        features: of every state, float32 ``[N, D]``.
        surrounding: the states ahead, right, back and left of each, int64 ``[N, 4]``.
        match: ``views`` or ``front``, see `TemplateStop`.
    """
    return normal_vectors(features if match == "front" else features[surrounding].flatten(1))


def scene_vectors(world: World, index: int, match: str) -> Tensor:
    """`template_vectors` of one scene of a world; those of all scenes together would take much memory."""
    states = slice(world.offsets[index], world.offsets[index] + len(world.scenes[index]))
    return template_vectors(world.features[states], world.surrounding[states] - world.offsets[index], match)


def look_alike(world: World, threshold: float) -> tuple[Tensor, Tensor]:
    """Which states of a scene look alike, by their four views.

    Returns:
        A table, bool ``[Q]``, and of each state its row, int64 ``[N]``: states a and b of one scene look alike where
        ``table[row[a] + b]``. Q is the sum of squares of the scenes' states.
    """
    blocks, rows, place = [], [], 0
    for index, offset in enumerate(world.offsets):
        of_scene = scene_vectors(world, index, "views")
        size = len(of_scene)
        blocks.append((of_scene @ of_scene.T > threshold).flatten())
        rows.append(place - offset + size * torch.arange(size, device=world.device))
        place += size * size
    return torch.cat(blocks), torch.cat(rows)


@dataclass(frozen=True)
class TemplateStop:
    """Stop where the observation matches the goal.

    Args:
        threshold: stop above this coefficient (the paper's is 0.9).
        match: what is compared: ``views``, all four of them, or ``front``, the one ahead.
    """

    threshold: float = 0.9
    match: str = "views"

    def __post_init__(self) -> None:
        if self.match not in ("views", "front"):
            raise ValueError(f"match is 'views' or 'front', not '{self.match}'")

    def scores(self, world: World) -> Tensor:
        """The coefficient of every pair of a goal and a state of its scene, float32 ``[P]``, see `World.pair`."""
        found = []
        for index in range(len(world.scenes)):
            of_scene = scene_vectors(world, index, self.match)
            found.append((of_scene[world.local_goals(index)] @ of_scene.T).flatten())
        return torch.cat(found)

    def __call__(self, world: World) -> Tensor:
        """Where an agent stops on its way to each goal, bool ``[P]``; not where it cannot be reached from."""
        return (self.scores(world) > self.threshold) & (world.distances >= 0)


def stop_errors(stop: Tensor, world: World) -> dict[str, float]:
    """How often a stop rule errs, over states: ``false`` of those that are not the goal, ``missed`` of the goals."""
    at_goal = world.pair(torch.arange(len(world.goals), device=world.device), world.goals)
    elsewhere = world.distances > 0
    return {
        "false": float((stop & elsewhere).sum() / elsewhere.sum()),
        "missed": float((~stop[at_goal]).float().mean()),
    }
