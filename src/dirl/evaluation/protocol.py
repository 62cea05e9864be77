"""Evaluation of a policy: the protocol, ATL, SR and SPL (paper section 4.3), and since when a training is stable."""

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import nn

from dirl.config.components import tried
from dirl.evaluation.episodes import Episodes, Metric, RandomPolicy, shortest_episodes
from dirl.evaluation.episodes import EvaluationProtocol as EvaluationProtocol
from dirl.models import LocalisingMemory, PlanningMemory
from dirl.scenes.world import World

Report = dict[str, Any]
"""Measures by name; under ``scenes``, and there under ``goals``, those of each."""

WINDOW = 100
"""Training episodes of a goal that its current ATL is the mean of."""

STABLE_ATL = 20.0
"""A policy is called stable while the current ATL of every goal is at or under this."""


def assess(policy: nn.Module, protocol: EvaluationProtocol) -> dict[str, Report]:
    """Return the metrics of a policy, greedy and sampled, and of shortest path and random, from the same starts.

    Where a memory plans without a map, two controls stand in the place of sampled actions: ``sweep``, the same memory
    without a policy, and ``another_goal``, the agent that is led to another goal of its scene, and stops at its own.

    A policy without parameters has a single result: that of random actions or of the shortest path. Held-out goals are
    evaluated separately, under ``held_out``.
    """
    if protocol.held_out is not None:
        apart = assess(policy, protocol.held_out)
        held_out = {key: row for key, row in apart.items() if key != "shortest_path"}
        return {**assess(policy, replace(protocol, held_out=None)), "held_out": held_out}
    world = protocol.world
    baselines = {
        "shortest_path": report(shortest_episodes(world, protocol.starts), world, protocol.metric),
        "random": report(protocol.run_random(), world, protocol.metric),
    }
    if isinstance(policy, RandomPolicy):
        return {**baselines, "greedy": baselines["random"], "sampled": baselines["random"]}
    reports = {**baselines, "greedy": report(protocol.run(policy), world, protocol.metric)}
    if isinstance(protocol.memory, PlanningMemory | LocalisingMemory) and protocol.maps is None:
        alone = replace(protocol, walked=())
        # No policy, but the same memory, which knows as well whether a move was blocked, stop, panorama and arrows.
        reports["sweep"] = report(alone.run(RandomPolicy(policy)), world, protocol.metric)
        if all(len(goals) > 1 for goals in world.goals_of):
            misled = replace(alone, shown=other_goals(world))
            reports["another_goal"] = report(misled.run(policy), world, protocol.metric)
    else:
        reports["sampled"] = report(protocol.run(policy, greedy=False), world, protocol.metric)
    return reports if protocol.live is None else reports | assess_live(policy, protocol.live)


def other_goals(world: World) -> torch.Tensor:
    """Return for each goal the one that is half of its scene's goals farther on, int64 ``[G]``."""
    places = [torch.arange(goals.start, goals.stop).roll(-(len(goals) // 2)) for goals in world.goals_of]
    return torch.cat(places).to(world.device)


def assess_live(policy: nn.Module, live: Callable[..., Episodes]) -> dict[str, dict[str, float]]:
    """Return the metrics of a policy in a live world: stopping by itself, and told when it has arrived."""
    return {"live": metrics(live(policy)), "live_told": metrics(live(policy, told=True))}


def metrics(episodes: Episodes, metric: Metric | None = None) -> dict[str, float]:
    """Return the measures of the paper's section 4.3, over all episodes unless said otherwise.

    ``atl``: steps, with the limit for failures; ``atl_success``: steps of the successful ones (NaN if there are
    none); ``sr``: fraction that stopped at the goal; ``spl``: success weighted by shortest/steps; ``shortest``: fewest
    possible steps; ``false_stop_rate`` and ``missed_stop_rate``: fractions; ``episodes``: how many. With a ``metric``
    of a user's own also what that says of them.

    Raises:
        ConfigError: the metric fails, or gives anything but numbers by names that are not taken.
    """
    success = episodes.success.double()
    steps, shortest = episodes.steps.double(), episodes.shortest.double()
    means = {
        "atl": steps.mean().item(),
        "atl_success": steps[episodes.success].mean().item(),
        "sr": success.mean().item(),
        "spl": (success * shortest / torch.maximum(steps, shortest)).mean().item(),
        "shortest": shortest.mean().item(),
        "false_stop_rate": episodes.false_stop.double().mean().item(),
        "missed_stop_rate": episodes.missed_stop.double().mean().item(),
        "episodes": len(steps),
    }
    if metric is None:
        return means
    with tried("metric", metric):
        own = metric(episodes)
        if not isinstance(own, Mapping) or not own:
            raise TypeError(f"gave {type(own).__name__}; expected numbers by name")
        wrong = [name for name, value in own.items() if not isinstance(value, int | float) or name in means]
        if wrong:
            raise TypeError(f"{wrong[0]}={own[wrong[0]]!r:.40}: expected a number under a name of its own")
    return means | {name: float(value) for name, value in own.items()}


def report(episodes: Episodes, world: World, metric: Metric | None = None) -> Report:
    """Return `metrics` overall; under ``scenes`` those of each scene, and under its ``goals`` those of each goal."""
    summary: Report = {**metrics(episodes, metric), "scenes": {}}
    order = torch.argsort(episodes.goal_index, stable=True)
    sizes = torch.bincount(episodes.goal_index, minlength=len(world.goals)).tolist()
    of_goals = order.split(sizes)
    for index, name in enumerate(world.names):
        inside = world.scene_of[episodes.start] == index
        goals = zip(world.local_goals(index).tolist(), world.goals_of[index], strict=True)
        by_goal = {str(goal): metrics(episodes.select(of_goals[place]), metric) for goal, place in goals}
        summary["scenes"][name] = {**metrics(episodes.select(inside), metric), "goals": by_goal}
    return summary


class EpisodeMeter:
    """Lengths of the latest training episodes of each of G goals, and the frame from which the policy is stable."""

    def __init__(self, goals: int) -> None:
        self.steps: list[deque[int]] = [deque(maxlen=WINDOW) for _ in range(goals)]
        self.totals = [0] * goals
        """Of ``steps``, so that an update does not add up the episodes of hundreds of goals again."""
        self.episodes = 0
        self.stable_at: int | None = None

    def add(self, goal_index: Sequence[int], steps: Sequence[int], frames: int) -> None:
        """Count finished episodes in the order they ended; the last ended by ``frames``.

        The policy is stable from the first frame after which the mean steps of the last `WINDOW` episodes stay at or
        under `STABLE_ATL` for every goal.
        """
        for goal, length in zip(goal_index, steps, strict=True):
            last = self.steps[goal]
            self.totals[goal] += length - (last[0] if len(last) == WINDOW else 0)
            last.append(length)
        self.episodes += len(steps)
        full = all(len(last) == WINDOW for last in self.steps)
        if not (full and max(self.totals) <= STABLE_ATL * WINDOW):
            self.stable_at = None
        elif self.stable_at is None:
            self.stable_at = frames

    def measures(self, limit: int) -> dict[str, float]:
        """Return the current ATL averaged over the goals that have episodes, that of the worst goal, and ``sr``.

        ``sr`` is the fraction of the latest episodes that ended before the step limit, averaged over goals as well. All
        are NaN before there is an episode.
        """
        means = [total / len(last) for last, total in zip(self.steps, self.totals, strict=True) if last]
        rates = [sum(steps < limit for steps in last) / len(last) for last in self.steps if last]
        return {
            "atl": sum(means) / len(means) if means else math.nan,
            "atl_worst_goal": max(means, default=math.nan),
            "episodes": self.episodes,
            "sr": sum(rates) / len(rates) if rates else math.nan,
        }

    def state_dict(self) -> Report:
        """Return what `load_state_dict` takes."""
        return {"steps": [list(last) for last in self.steps], "episodes": self.episodes, "stable_at": self.stable_at}

    def load_state_dict(self, state: Report) -> None:
        """Restore a saved state."""
        self.steps = [deque(last, maxlen=WINDOW) for last in state["steps"]]
        self.totals = [sum(last) for last in self.steps]
        self.episodes, self.stable_at = state["episodes"], state["stable_at"]
