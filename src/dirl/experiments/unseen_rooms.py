"""Rooms that no training saw: how well goals are found in them, beside controls, by the number of training rooms."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from matplotlib.figure import Figure
from torch import Tensor
from tqdm import tqdm

from dirl.config.choices import goal_view_options
from dirl.evaluation.episodes import Episodes
from dirl.evaluation.protocol import metrics
from dirl.experiments.any_goal import (
    DRAWN,
    FAR,
    FAR_NAMES,
    FOUR,
    MEASURES,
    PHOTO,
    ambiguous,
    main_variant,
    variant,
    walked_by,
    within,
)
from dirl.experiments.results import Column, Result, Table, grouped, save_figure, write_tables
from dirl.models import EpisodicMemory, PlanningMemory
from dirl.reporting.statistics import bootstrap_interval, iqm
from dirl.reporting.style import plain
from dirl.scenes import SceneError, World

GOALS, STARTS = 30, 20
"""Goals of each room, and episodes of each room and distance."""

MAX_STEPS = 100

THRESHOLDS = (0.8, 0.85, 0.9, 0.95, 0.98)
"""Of the matching, compared in the validation rooms."""

TESTED: Mapping[str, Any] = {
    "split": "test",
    "rooms": None,
    "goals": "all",
    "evaluation.goals": GOALS,
    "evaluation.max_steps": MAX_STEPS,
}


def drawn_starts(world: World, each: int = STARTS, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Up to ``each`` episodes of every room and distance of `FAR`: goal index and start, int64 ``[E]`` each."""
    generator = torch.Generator().manual_seed(seed)
    goal_index, state = world.pairs()
    scene, distance = world.scene_of[state], world.distances.long()
    chosen = []
    for room in range(len(world.scenes)):
        for low, high in FAR:
            fitting = torch.nonzero((scene == room) & (distance >= low) & (distance <= high)).flatten()
            chosen.append(fitting[torch.randperm(len(fitting), generator=generator)[:each]])
    kept = torch.cat(chosen)
    return goal_index[kept], state[kept]


def tested(run: Result) -> tuple[World, dict[str, Episodes]]:
    """Episodes in the test rooms of the collection that a run was trained on, by what walked them."""
    config, policy, protocol = run.load(TESTED)
    _, by_photo, photo = run.load({**TESTED, **goal_view_options("front")})
    starts = drawn_starts(protocol.world)
    four, one = (replace(conditions, starts=starts) for conditions in (protocol, photo))
    found = walked_by(policy, four, by_photo, one, config.stop.threshold, starts)
    if isinstance(protocol.memory, PlanningMemory):
        for name, conditions, walker in ((FOUR, four, policy), (PHOTO, one, by_photo)):
            found[f"{name}, memory of counts"] = replace(conditions, memory=EpisodicMemory()).run(walker)
    return protocol.world, found


def by_room(world: World, episodes: Episodes, key: str) -> list[float]:
    """A measure in each room."""
    room = world.scene_of[episodes.start]
    return [metrics(episodes.select(room == index))[key] for index in room.unique().tolist()]


def report_unseen_rooms(results: Sequence[Result], out: Path, note: str) -> str:
    """Write how well goals are found in rooms that no training saw.

    Args:
        results: runs on the training rooms of one collection, with any number of them.
        out: a folder.
        note: what a reader must know of the runs.

    Returns:
        The text of the README.
    """
    variants = grouped(results, variant)
    main = main_variant(variants)
    found = _tested_by_count(variants.pop(main))
    most = found[max(found)]
    world = most[0][0]
    parts = Table(Column("system", "s"), Column("training rooms", "d"), Column("runs", "d"), *_curve_columns())
    for name, tests in {main: found, **{name: _tested_by_count(runs) for name, runs in variants.items()}}.items():
        count = max(tests)
        parts.add(name, count, len(tests[count]), *_curve_cells(tests[count]))
    table = Table(Column("walks by"), Column("runs", "d"), *(Column(name, ".3f") for name in MEASURES.values()))
    far = Table(Column("SPL, walks by"), *(Column(name, ".3f") for name in FAR_NAMES))
    for way in most[0][1]:
        table.add(way, len(most), *(_rooms(most, way, key) for key in MEASURES))
        near = [[(one, {way: within(episodes[way], *limits)}) for one, episodes in most] for limits in FAR]
        far.add(way, *(_rooms(part, way, "spl") for part in near))
    curve = Table(Column("training rooms", "d"), Column("runs", "d"), *_curve_columns())
    for count, runs in found.items():
        curve.add(count, len(runs), *_curve_cells(runs))
    _draw(most, out)
    text = (
        f"{note}\n\nTested in {len(world.scenes)} rooms of the test split, which no training saw: {STARTS} episodes of "
        f"each room and distance, at most {MAX_STEPS} steps, stop by template matching. Of several numbers: "
        "interquartile mean over rooms and, in brackets, its 95 % bootstrap interval over rooms."
    )
    tables = {"unseen_rooms": table, "unseen_rooms_by_start": far, "unseen_rooms_by_training": curve}
    tables["unseen_rooms_by_kind"] = _by_kind(most)
    tables["unseen_rooms_parts"] = parts
    if thresholds := _thresholds(results[0]):
        tables["unseen_rooms_thresholds"] = thresholds
    shown = "SR and SPL in unseen rooms: with four views, with one photo, without memory, and of controls"
    return write_tables(out, "Unseen rooms", text, tables, {"unseen_rooms": shown})


def _tested_by_count(runs: Sequence[Result]) -> dict[int, list[tuple[World, dict[str, Episodes]]]]:
    """The test of each run, by the number of rooms that it was trained in."""
    found: dict[int, list[tuple[World, dict[str, Episodes]]]] = {}
    for run in tqdm(sorted(runs, key=lambda run: len(run.scenes)), desc="unseen rooms", unit=" runs", disable=None):
        found.setdefault(len(run.scenes), []).append(tested(run))
    return found


def _by_kind(found: Sequence[tuple[World, Mapping[str, Episodes]]]) -> Table:
    """SR and SPL in the rooms of each kind, which their names begin with."""
    names = [name.rpartition("_")[0] for name in found[0][0].names]
    table = Table(Column("kind", "s"), Column("rooms", "d"), *_curve_columns())
    for kind in dict.fromkeys(names):
        own = [index for index, name in enumerate(names) if name == kind]
        table.add(kind, len(own), *([cell[index] for index in own] for cell in _curve_cells(found)))
    return table


def _thresholds(run: Result) -> Table | None:
    """Of all goals in the validation rooms, if there are any, how many look like another state above a threshold."""
    try:
        _, _, protocol = run.load({**TESTED, "split": "validation", "evaluation.goals": None})
    except SceneError:
        return None
    world = protocol.world
    table = Table(Column("threshold", ".2f"), Column("goals", "d"), *(Column(name, "d") for name in (FOUR, PHOTO)))
    for threshold in THRESHOLDS:
        alike = [int(ambiguous(world, threshold, match).sum()) for match in ("views", "front")]
        table.add(threshold, len(world.goals), *alike)
    return table


def _curve_cells(found: Sequence[tuple[World, Mapping[str, Episodes]]]) -> list[list[float]]:
    return [_rooms(found, way, key) for way in (FOUR, PHOTO) for key in ("sr", "spl")]


def _curve_columns() -> list[Column]:
    return [Column(f"{name}, {way}", ".3f") for way in (FOUR, PHOTO) for name in ("SR", "SPL")]


def _rooms(found: Sequence[tuple[World, Mapping[str, Episodes]]], way: str, key: str) -> list[float]:
    """A measure in each room, the mean of the runs."""
    runs = torch.tensor([by_room(world, episodes[way], key) for world, episodes in found], dtype=torch.float64)
    values: list[float] = runs.mean(0).tolist()
    return values


def _draw(found: Sequence[tuple[World, Mapping[str, Episodes]]], out: Path) -> None:
    """SR and SPL of each way, the interquartile mean over rooms with its interval."""
    figure = Figure(figsize=(9, 3.4), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    places = list(range(len(DRAWN)))[::-1]
    for axes, key in zip(panels, ("sr", "spl"), strict=True):
        for place, (way, color) in zip(places, DRAWN.items(), strict=True):
            values = _rooms(found, way, key)
            low, high = bootstrap_interval(values)
            axes.plot([low, high], [place, place], color=color, linewidth=5, alpha=0.35, solid_capstyle="butt")
            axes.plot(iqm(values), place, "o", color=color)
        axes.set_yticks(places, list(DRAWN))
        axes.set(xlabel=MEASURES[key], xlim=(-0.04, 1.04))
        plain(axes)
    save_figure(figure, out, "unseen_rooms")
