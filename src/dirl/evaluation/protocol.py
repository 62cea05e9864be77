"""Evaluation of a policy: the protocol, and ATL, SR and SPL (paper section 4.3)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor, nn

from dirl.agent.agent import Memory
from dirl.agent.decisions import answers
from dirl.agent.mapping.places import PlaceMap
from dirl.envs import SurroundingViews
from dirl.evaluation.episodes import Episodes, run_episodes, shortest_episodes
from dirl.evaluation.experts import RandomPolicy
from dirl.evaluation.live import LiveProtocol
from dirl.perception.recognition.matching import Arrived
from dirl.perception.recognition.tables import VisitScores
from dirl.scenes import World


@dataclass(frozen=True)
class EvaluationProtocol:
    """The conditions under which policies are evaluated."""

    world: World
    observation: SurroundingViews
    """What the policies observe."""
    starts: tuple[Tensor, Tensor]
    """Goal index and start state of each episode, int64 ``[E]`` each; see `dirl.evaluation.episodes.every_start`."""
    stop: Tensor | Arrived | None = None
    """Where an agent stops on its way to each goal, see `run_episodes`; None = exactly at the goal."""
    max_steps: int = 200
    """An episode that has not arrived by then has failed."""
    seed: int = 0
    """Of sampled actions."""
    memory: Memory | None = None
    """Changes the policies' logits by what was done in the episode."""
    scores: VisitScores | None = None
    """By which the memory knows places; None = correlation."""
    maps: Sequence[PlaceMap] | None = None
    """Of a walk through each scene, with which a `LocalisingMemory` begins; None = it knows nothing."""
    looks: range | None = None
    """Of visits and goals in a world that changes; None = all."""
    photos: range | None = None
    """Of goals, if they are others."""
    shown: Tensor | None = None
    """The goal that is shown in the place of each, int64 ``[G]``, for controls; None = the goal itself."""
    live: LiveProtocol | None = None
    """The same in the simulator that the policy was trained in, if it was."""
    held_out: "EvaluationProtocol | None" = None
    """The same for goals that were held out of the training, if there are any."""

    def run(self, policy: nn.Module, *, greedy: bool = True) -> Episodes:
        """One episode from each start."""
        return run_episodes(policy, self.world, self.starts, greedy=greedy, **self._conditions())

    def run_random(self) -> Episodes:
        """The same for random actions. The environment stops the agent, so that it makes no false stops."""
        return replace(self, stop=None, memory=None, maps=None).run(RandomPolicy(), greedy=False)

    def trajectories(
        self, policy: nn.Module, starts: tuple[Tensor, Tensor], *, greedy: bool = True
    ) -> tuple[Episodes, list[list[int]]]:
        """Episodes from given starts, and the states that each passed, from its start to its last state."""
        paths = [[state] for state in starts[1].tolist()]

        def watch(walking: Tensor, state: Tensor, _: Tensor) -> None:
            for episode, passed in zip(walking.tolist(), state.tolist(), strict=True):
                paths[episode].append(passed)

        return run_episodes(policy, self.world, starts, greedy=greedy, watch=watch, **self._conditions()), paths

    def walks(self, policy: nn.Module, starts: tuple[Tensor, Tensor]) -> list[Tensor]:
        """The actions of greedy episodes from given starts, until each stops or fails; int64 ``[steps]`` each."""
        steps: list[tuple[Tensor, Tensor]] = []
        run_episodes(
            policy,
            self.world,
            starts,
            watch=lambda walking, _, action: steps.append((walking, action)),
            **self._conditions(),
        )
        episode, action = (torch.cat(parts) for parts in zip(*steps, strict=True))
        order = torch.argsort(episode, stable=True)
        return list(action[order].split(torch.bincount(episode, minlength=len(starts[0])).tolist()))

    def _conditions(self) -> dict[str, Any]:
        names = ("observation", "stop", "max_steps", "seed", "memory", "scores", "maps", "looks", "photos", "shown")
        return {name: getattr(self, name) for name in names}


def assess(policy: nn.Module, protocol: EvaluationProtocol) -> dict[str, dict[str, Any]]:
    """The metrics of a policy, greedy and sampled, and of shortest path and random, from the same starts.

    A policy without parameters has a single result: that of random actions or of the shortest path. Held-out goals are
    evaluated separately, under ``held_out``.
    """
    if protocol.held_out is not None:
        apart = assess(policy, protocol.held_out)
        held_out = {key: apart[key] for key in ("greedy", "sampled", "random")}
        return {**assess(policy, replace(protocol, held_out=None)), "held_out": held_out}
    world = protocol.world
    baselines = {
        "shortest_path": report(shortest_episodes(world, protocol.starts), world),
        "random": report(protocol.run_random(), world),
    }
    if isinstance(policy, RandomPolicy):
        return {**baselines, "greedy": baselines["random"], "sampled": baselines["random"]}
    found = {
        **baselines,
        "greedy": report(protocol.run(policy), world),
        "sampled": report(protocol.run(policy, greedy=False), world),
    }
    return found if protocol.live is None else found | assess_live(policy, protocol.live)


def assess_live(policy: nn.Module, live: LiveProtocol) -> dict[str, dict[str, float]]:
    """The metrics of a policy in a live world: stopping by itself, and told when it has arrived."""
    return {"live": metrics(live.run(policy)), "live_told": metrics(live.run(policy, told=True))}


def mean_shortest(world: World) -> list[float]:
    """The length of the shortest path to each goal, averaged over the states that reach it."""
    blocks = [world.block(world.distances, goal) for goal in range(len(world.goals))]
    return [block[block > 0].double().mean().item() for block in blocks]


def action_values(
    policy: nn.Module, world: World, observation: SurroundingViews, goal_index: int
) -> tuple[Tensor, Tensor]:
    """Probabilities ``[n, 4]`` and state value ``[n]`` on the way to a goal, in its scene's states; see `answers`."""
    logits, values = answers(policy, world, observation, goal_index)
    return logits.softmax(-1), values


def metrics(episodes: Episodes) -> dict[str, float]:
    """The measures of the paper's section 4.3, over all episodes unless said otherwise.

    ``atl``: steps, with the limit for failures; ``atl_success``: steps of the successful ones (NaN if there are
    none); ``sr``: fraction that stopped at the goal; ``spl``: success weighted by shortest/steps; ``shortest``: fewest
    possible steps; ``false_stop_rate`` and ``missed_stop_rate``: fractions; ``episodes``: how many.
    """
    success = episodes.success.double()
    steps, shortest = episodes.steps.double(), episodes.shortest.double()
    return {
        "atl": steps.mean().item(),
        "atl_success": steps[episodes.success].mean().item(),
        "sr": success.mean().item(),
        "spl": (success * shortest / torch.maximum(steps, shortest)).mean().item(),
        "shortest": shortest.mean().item(),
        "false_stop_rate": episodes.false_stop.double().mean().item(),
        "missed_stop_rate": episodes.missed_stop.double().mean().item(),
        "episodes": len(steps),
    }


def report(episodes: Episodes, world: World) -> dict[str, Any]:
    """`metrics` overall; under ``scenes`` those of each scene, and under its ``goals`` those of each goal's state."""
    summary: dict[str, Any] = {**metrics(episodes), "scenes": {}}
    order = torch.argsort(episodes.goal_index, stable=True)
    sizes = torch.bincount(episodes.goal_index, minlength=len(world.goals)).tolist()
    for goal, those in zip(world.goals.tolist(), order.split(sizes), strict=True):
        scene, local = world.local(goal)
        if scene.name not in summary["scenes"]:
            inside = world.scene_of[episodes.start] == world.scene_of[goal]
            summary["scenes"][scene.name] = {**metrics(episodes.select(inside)), "goals": {}}
        summary["scenes"][scene.name]["goals"][str(local)] = metrics(episodes.select(those))
    return summary
