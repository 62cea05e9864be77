"""Goals held out in known rooms: how well they are found, beside controls, and what each part of the system gives."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from dirl.config.components import TARGET
from dirl.config.schemas import TrainConfig
from dirl.evaluation.episodes import Episodes, sampled_starts, shortest_episodes
from dirl.evaluation.protocol import metrics
from dirl.experiments.figures import band, panels, save_figure
from dirl.experiments.measures import (
    FAR,
    FOUR,
    MEASURES,
    PHOTO,
    RANDOM,
    SWEEP,
    UNREACHED,
    WRONG,
    Found,
    ambiguous,
    controls,
    decimals,
    measure_table,
    within,
    wrong_goals,
)
from dirl.experiments.results import Result, Table, grouped, write_tables
from dirl.scenes import World
from dirl.scenes.palette import GREEN, GREY, ORANGE, SKY, VERMILION, WINE
from dirl.training.build import Trained, build_goals

DRAWN = {
    FOUR: WINE,  # of the system
    PHOTO: SKY,
    f"{FOUR}, without memory": GREEN,
    WRONG: VERMILION,
    SWEEP: ORANGE,
    RANDOM: GREY,
}
"""What the figure shows, and in which colour."""

STARTS = 20
"""Of each goal in the controls."""


def with_held_out(run: Result, goal_view: str | None = None) -> Trained:
    """A run, to be evaluated at the goals that it held out."""
    trained = run.load({"evaluation.goals": None}, goal_view)
    assert trained.protocol.held_out is not None
    return trained._replace(protocol=trained.protocol.held_out)


def walked(run: Result) -> tuple[World, dict[str, Episodes]]:
    """Episodes from every start to every goal that was held out, by what walked them."""
    trained = with_held_out(run)
    world = trained.protocol.world
    starts = sampled_starts(world, STARTS, run.config.seed)
    return world, walked_by(trained, with_held_out(run, "front"), starts)


def walked_by(four: Trained, one: Trained, starts: tuple[Tensor, Tensor]) -> dict[str, Episodes]:
    """Episodes of an agent that is shown four views of its goal, of it shown one photo, and of controls.

    Controls begin at ``starts``: many of their episodes do not end before the limit.
    """
    config, policy, protocol = four
    _, by_photo, photo = one
    few = replace(protocol, starts=starts)
    alone = replace(few, memory=None)
    wrong = replace(alone, shown=wrong_goals(protocol.world), stop=None)
    control = controls(policy, few)
    found = photo.run(by_photo)
    told = ~ambiguous(protocol.world, config.stop.threshold)[found.goal_index]
    return {
        "shortest path": shortest_episodes(protocol.world, protocol.starts),
        FOUR: protocol.run(policy),
        f"{FOUR}, without memory": alone.run(policy),
        f"{FOUR}, without memory, sampled": alone.run(policy, greedy=False),
        PHOTO: found,
        f"{PHOTO}, of those that no other view matches": found.select(told),
        f"{PHOTO}, without memory": replace(photo, starts=starts, memory=None).run(by_photo),
        WRONG: control[WRONG](),
        f"{WRONG}, without memory, sampled": wrong.run(policy, greedy=False),
        SWEEP: control[SWEEP](),
        RANDOM: control[RANDOM](),
    }


def variant(config: TrainConfig) -> str:
    """What a run has of the system's parts, and what was added to them."""
    encoder = "compared" if config.encoder[TARGET].endswith("ComparingEncoder") else "embedded side by side"
    noise = f"noise {config.imitation.noise:g}" if config.imitation.noise else "no noise"
    at_once = encoder == "compared" and not config.encoder.get("pair_width", 0)
    added = ["views read at once"] if at_once else []
    added += [f"{config.imitation.rounds} rounds of DAgger"] if config.imitation.rounds else []
    added += [config.memory[TARGET].rpartition(".")[2]] if config.memory[TARGET] else []
    added += [f"then {name.upper()}" for name in ("a2c", "ppo") if name in config.losses]
    return ", ".join([f"goal {encoder}", noise, f"{config.imitation.front_only:.0%} photos", *added])


def main_variant(variants: Mapping[str, Sequence[Result]]) -> str:
    """Which of the groups by `variant` has the system's parts and nothing else; of several the one with most runs."""
    return max(
        variants, key=lambda name: ("compared" in name, "no noise" not in name, -name.count(","), len(variants[name]))
    )


def report_any_goal(results: Sequence[Result], out: Path, note: str) -> str:
    """Write how well goals are found that were held out, and what each part of the system gives."""
    variants = grouped(results, variant)
    main = main_variant(variants)
    found = [walked(run) for run in tqdm(variants[main], desc="any goal", unit=" runs", disable=None)]
    table = measure_table({"walks by": "", "runs": "d"})
    by_start = Table({"SPL, walks by": "", **decimals(FAR)})
    for way in found[0][1]:
        measured = [metrics(episodes[way]) for _, episodes in found]
        table.add(way, len(measured), *([one[key] for one in measured] for key in MEASURES))
        by_start.add(way, *([metrics(within(of[way], *limits))["spl"] for _, of in found] for limits in FAR.values()))
    tables = {
        "any_goal": table,
        "any_goal_by_start": by_start,
        "any_goal_by_trained": _by_trained(variants[main], found),
        "any_goal_parts": _parts(variants),
    }
    _draw(found, out)
    single = sum(int(ambiguous(world, 0.95).sum()) for world, _ in found) / len(found)
    goals = sum(len(world.goals) for world, _ in found) / len(found)
    text = (
        f"{note}\n\nGoals: {goals:.0f} states of places that were sampled and never trained; every start of their "
        f"rooms ({STARTS} sampled ones of each goal for controls and without memory), at most "
        f"{results[0].config.evaluation.max_steps} steps, stop by template matching. The first tables are of: "
        f"{main}. Of a photo, {single:.1f} goals look above 0.95 like another view; they are counted in all rows but "
        "one. A sweep tries in each place the action that it tried least and stops where the goal's views match. "
        "*Another goal's views* are shown in the place of the goal's; the environment stops the agent at the goal."
    )
    shown = "SR and SPL over the fewest steps from start to goal: with four views, with one photo, and of controls"
    return write_tables(out, "Any goal of known rooms", text, tables, {"any_goal": shown})


def _by_trained(runs: Sequence[Result], found: Found) -> Table:
    """SR and SPL by how far a goal is from the nearest trained one."""
    measured = decimals(["SR, four views", "SPL, four views", "SPL, one photo"])
    table = Table({"steps to the nearest trained goal": "d", "goals": ".0f", **measured})
    rows: dict[int, list[tuple[int, float, float, float]]] = {}
    for run, (world, episodes) in zip(runs, found, strict=True):
        nearest = nearest_trained(run.config, world)
        for distance in nearest.unique().tolist():
            chosen = nearest == distance
            four, one = (metrics(episodes[way].select(chosen[episodes[way].goal_index])) for way in (FOUR, PHOTO))
            rows.setdefault(distance, []).append((int(chosen.sum()), four["sr"], four["spl"], one["spl"]))
    for distance, values in sorted(rows.items()):
        table.add(distance, *map(list, zip(*values, strict=True)))
    return table


def nearest_trained(config: TrainConfig, world: World) -> Tensor:
    """The fewest steps from each held-out goal to a trained one of its scene, int64 ``[G]``."""
    trained: Any = build_goals(config, world.scenes).trained
    found = torch.zeros(len(world.goals), dtype=torch.int64)
    for index, scene in enumerate(world.scenes):
        distances = scene.distances[np.ix_(world.local_goals(index).numpy(), trained[scene.name])]
        found[world.goals_in(index)] = torch.from_numpy(np.where(distances < 0, UNREACHED, distances).min(1)).long()
    return found


def _parts(variants: Mapping[str, Sequence[Result]]) -> Table:
    """Held-out goals found by runs that lack a part, by goal view, with and without the memory."""
    ways = ("", ", no memory", ", one photo", ", one photo, no memory")
    measured = decimals(f"{measure}{way}" for way in ways for measure in ("SR", "SPL"))
    table = Table({"part of the system": "", "runs": "d", **measured})
    for name, runs in variants.items():
        by_way = zip(*map(_with_and_without_memory, runs), strict=True)
        table.add(name, len(runs), *([one[key] for one in way] for way in by_way for key in ("sr", "spl")))
    return table


def _with_and_without_memory(run: Result) -> list[dict[str, float]]:
    """The measures of a run at held-out goals, from some starts of each; in the order of the table's columns."""
    found = []
    for view in (None, "front"):
        _, policy, protocol = with_held_out(run, view)
        few = replace(protocol, starts=sampled_starts(protocol.world, STARTS, run.config.seed))
        found += [metrics(one.run(policy)) for one in (few, replace(few, memory=None))]
    return found


def _draw(found: Found, out: Path) -> None:
    """SR and SPL by the fewest steps from start to goal, the mean of the runs with their interval."""
    figure, grid = panels(2, (9, 4.2))
    farthest = min(int(episodes[FOUR].shortest.max()) for _, episodes in found)
    edges = list(range(1, farthest, max(1, farthest // 10)))
    for axes, key in zip(grid, ("sr", "spl"), strict=True):
        for way, color in DRAWN.items():
            values = [
                [metrics(within(episodes[way], low, low + edges[1] - edges[0] - 1))[key] for low in edges]
                for _, episodes in found
            ]
            band(axes, edges, values, color, way if key == "sr" else None)
        axes.set(xlabel="fewest steps from start to goal", ylabel=MEASURES[key], ylim=(0, 1.03))
    figure.legend(loc="outside upper center", ncols=3, frameon=False)
    save_figure(figure, out, "any_goal")
