"""What the experiments on agents share: measures of episodes, starts by distance, and controls."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from dirl.config.choices import goal_view_options, group_options
from dirl.evaluation.episodes import Episodes
from dirl.evaluation.experts import RandomPolicy
from dirl.evaluation.protocol import EvaluationProtocol, metrics
from dirl.experiments.results import Table
from dirl.models import PlanningMemory
from dirl.perception.recognition.matching import TemplateStop
from dirl.runs.checkpoints import load_checkpoint
from dirl.scenes import World
from dirl.scenes.io.atomic import write_json
from dirl.scenes.io.bounded import read_text
from dirl.training.build import Trained, load_trained

FOUR, PHOTO = "four views of the goal", "one photo of the goal"
WRONG, SWEEP, RANDOM = "another goal's views", "sweep that ignores the goal", "random walk"

MEASURES = {"sr": "SR", "spl": "SPL", "false_stop_rate": "false stops", "missed_stop_rate": "missed stops"}

UNREACHED = 10_000
"""More steps than any path has."""

FAR = {"1 to 4 steps": (1, 4), "5 to 9 steps": (5, 9), "10 steps and more": (10, UNREACHED)}
"""Fewest steps from start to goal, in which episodes are told apart."""

GOALS, STARTS = 30, 20
"""Goals of each room, and episodes of each room and distance."""

MAX_STEPS = 100

Found = Sequence[tuple[World, Mapping[str, Episodes]]]
"""Of each run the world that it was tested in, and its episodes by what walked them."""


def measure_table(columns: Mapping[str, str]) -> Table:
    """A table of all `MEASURES`, over rooms, behind some other columns."""
    worst = {name: min if key in ("sr", "spl") else max for key, name in MEASURES.items()}
    return Table({**columns, **decimals(MEASURES.values())}, worst)


def decimals(headings: Any) -> dict[str, str]:
    """Columns of numbers with three decimals."""
    return dict.fromkeys(headings, ".3f")


def within(episodes: Episodes, low: int, high: int) -> Episodes:
    """Those that begin so many steps from their goal, both limits included."""
    return episodes.select((episodes.shortest >= low) & (episodes.shortest <= high))


def by_room(world: World, episodes: Episodes, key: str) -> list[float]:
    """A measure in each room."""
    room = world.scene_of[episodes.start]
    return [metrics(episodes.select(room == index))[key] for index in room.unique().tolist()]


def by_measure(world: World, episodes: Episodes) -> dict[str, list[float]]:
    """`MEASURES` in each room."""
    return {key: by_room(world, episodes, key) for key in MEASURES}


def drawn_starts(world: World, each: int = STARTS, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Up to ``each`` episodes of every room and distance of `FAR`: goal index and start, int64 ``[E]`` each."""
    generator = torch.Generator().manual_seed(seed)
    goal_index, state = world.pairs()
    scene, distance = world.scene_of[state], world.distances.long()
    chosen = []
    for room in range(len(world.scenes)):
        for low, high in FAR.values():
            fitting = torch.nonzero((scene == room) & (distance >= low) & (distance <= high)).flatten()
            chosen.append(fitting[torch.randperm(len(fitting), generator=generator)[:each]])
    kept = torch.cat(chosen)
    return goal_index[kept], state[kept]


def wrong_goals(world: World) -> Tensor:
    """Another goal of the same scene in the place of each, int64 ``[G]``: half the scene's goals further on."""
    shown = torch.arange(len(world.goals), device=world.device)
    for index in range(len(world.scenes)):
        own = torch.tensor(world.goals_in(index), device=world.device)
        shown[own] = own.roll(len(own) // 2)
    return shown


def ambiguous(world: World, threshold: float, match: str = "front") -> Tensor:
    """Whether another state matches each goal, bool ``[G]``, by the view ahead or by all ``views``.

    What is compared cannot tell the two apart.
    """
    elsewhere = (TemplateStop(threshold, match).scores(world) > threshold) & (world.distances != 0)
    return torch.stack([world.block(elsewhere, goal).any() for goal in range(len(world.goals))])


def controls(policy: Any, protocol: EvaluationProtocol) -> dict[str, Callable[[], Episodes]]:
    """What a policy is compared with, by its name: episodes that are walked when they are asked for."""
    wrong = replace(protocol, shown=wrong_goals(protocol.world), stop=None)
    return {
        WRONG: lambda: wrong.run(policy),
        # Of sampled and first actions, those that find more goals.
        SWEEP: lambda: protocol.run(RandomPolicy(), greedy=isinstance(protocol.memory, PlanningMemory)),
        RANDOM: protocol.run_random,
    }


def load_agent(agent: str, changes: Mapping[str, Any], goal_view: str | None = None, **groups: str) -> Trained:
    """A checkpoint or an agent of the package, with options and groups of the configuration replaced."""
    chosen = {group: group_options(group, choice) for group, choice in groups.items()}
    return load_trained(load_checkpoint(agent), agent, {**goal_view_options(goal_view), **changes, **chosen})


def kept(file: Path, measure: Callable[[], Any]) -> Any:
    """What a JSON file holds; if there is none yet, it is measured and written."""
    if not file.exists():
        found = measure()
        file.parent.mkdir(parents=True, exist_ok=True)
        write_json(file, found)
    return json.loads(read_text(file))
