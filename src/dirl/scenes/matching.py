"""Template matching: knowing by sight that the goal has been reached (paper section 3.4)."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from dirl.scenes.world import World


def ncc(observation: Tensor, goal: Tensor) -> Tensor:
    """Normalised cross-correlation of feature vectors, i.e. Pearson's coefficient (paper equation 13).

    Args:
        observation: float ``[..., D]``.
        goal: float ``[..., D]``, broadcast against it.

    Returns:
        float ``[...]`` in [-1, 1]; 0 where one of the vectors is constant.
    """
    return (_normal(observation) * _normal(goal)).sum(-1)


def _normal(vector: Tensor) -> Tensor:
    centred = vector - vector.mean(-1, keepdim=True)
    # The mean of a constant vector is rounded; what is left of it then must not be blown up to length one.
    constant = vector.amax(-1, keepdim=True) == vector.amin(-1, keepdim=True)
    return F.normalize(centred.masked_fill(constant, 0.0), dim=-1)


def template_vectors(features: Tensor, surrounding: Tensor, match: str) -> Tensor:
    """What is compared of each state, so scaled that the product of two is their coefficient, float32 ``[N, D']``.

    Args:
        features: of every state, float32 ``[N, D]``.
        surrounding: the states ahead, right, back and left of each, int64 ``[N, 4]``.
        match: ``views`` or ``front``, see `TemplateStop`.
    """
    return _normal(features if match == "front" else features[surrounding].flatten(1))


@dataclass(frozen=True)
class TemplateStop:
    """Stop where what is seen matches the goal.

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
        vectors = template_vectors(world.features, world.surrounding, self.match)
        found = []
        for index, (scene, offset) in enumerate(zip(world.scenes, world.offsets, strict=True)):
            of_scene = vectors[offset : offset + len(scene)]
            goals = world.goals[world.goals_in(index)] - offset
            found.append((of_scene[goals] @ of_scene.T).flatten())
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
