"""Bounds of numbers: of options by their names, and of a constructor's parameters in their annotations.

A parameter is bounded as ``width: Annotated[int, Bounds(1)]``.
"""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Bounds:
    """The smallest and the largest value that a number may have, both included; None = no bound."""

    least: float | None = None
    most: float | None = None

    def __contains__(self, value: float) -> bool:
        """Whether a number lies within them."""
        return (self.least is None or value >= self.least) and (self.most is None or value <= self.most)

    def __str__(self) -> str:
        """In words, for errors."""
        if self.least is not None and self.most is not None:
            return f"between {self.least} and {self.most}"
        return f"at least {self.least}" if self.most is None else f"at most {self.most}"


LIMITS: Mapping[str, Bounds] = {
    "seed": Bounds(0, 2**63 - 1),
    "hold_out": Bounds(0, 0.99),
    "image_graph": Bounds(0, 100),
    "last_steps": Bounds(0, 10**6),
    "slip": Bounds(0, 0.99),
    "turn_error": Bounds(0, 90),
    "imitation.fraction": Bounds(0, 1),
    "imitation.lr": Bounds(0),
    "imitation.max_steps": Bounds(1),
    "imitation.loss_threshold": Bounds(0),
    "imitation.bc_coef.start": Bounds(0),
    "imitation.bc_coef.end": Bounds(0),
    "imitation.batch_size": Bounds(1),
    "imitation.front_only": Bounds(0, 1),
    "imitation.noise": Bounds(0, 100),
    "imitation.scenes_at_once": Bounds(1),
    "rooms": Bounds(1),
    "evaluation.goals": Bounds(1),
    "network.components": Bounds(1, 65_536),
    "imitation.rounds": Bounds(0),
    "imitation.walk_steps": Bounds(1),
    "reinforcement.frames_per_scene": Bounds(1, 10**12),
    "reinforcement.agents_per_scene": Bounds(1, 10**6),
    "reinforcement.workers": Bounds(1, 1024),
    "reinforcement.n_steps": Bounds(1, 10**6),
    "reinforcement.max_steps": Bounds(1),
    "reinforcement.epochs": Bounds(1),
    "reinforcement.minibatches": Bounds(1),
    "reinforcement.gamma": Bounds(0, 1),
    "reinforcement.lmbda": Bounds(0, 1),
    "reinforcement.max_grad_norm": Bounds(0),
    "reward.goal": Bounds(-(10**6), 10**6),
    "reward.step": Bounds(-(10**6), 10**6),
    "reward.collision": Bounds(-(10**6), 10**6),
    "reward.scale": Bounds(-(10**6), 10**6),
    "stop.threshold": Bounds(-1, 1),
    "evaluation.episodes_per_goal": Bounds(1, 10**7),
    "evaluation.max_steps": Bounds(1, 10**7),
    "evaluation.times": Bounds(0, 10**6),
    "checkpoint.every_seconds": Bounds(0),
    "checkpoint.keep": Bounds(1),
    "episodes_per_goal": Bounds(1, 10**7),
    "max_steps": Bounds(1, 10**7),
    "frames_per_scene": Bounds(1, 10**12),
    "repeats": Bounds(1),
    "goal": Bounds(0),
    "count": Bounds(1),
    "places": Bounds(2),
    "step": Bounds(0.05, 10),
    "turn": Bounds(1, 360),
    "headings": Bounds(4, 36),
    "tolerance": Bounds(0, 180),
    "reach": Bounds(0.1, 100),
    "pitch": Bounds(-80, 80),
    "height": Bounds(16, 4096),
    "width": Bounds(16, 4096),
    "field_of_view": Bounds(10, 150),
    "threshold": Bounds(-1, 1),
}
"""Of the options of all recipes that are not those of a component."""
