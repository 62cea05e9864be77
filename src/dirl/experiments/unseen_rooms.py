"""Rooms that no training saw: how well goals are found in them, beside controls, by the number of training rooms."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from tqdm import tqdm

from dirl.evaluation.episodes import Episodes
from dirl.experiments.any_goal import DRAWN, main_variant, variant, walked_by
from dirl.experiments.figures import interval_row, panels, save_figure
from dirl.experiments.measures import (
    FAR,
    FOUR,
    GOALS,
    MAX_STEPS,
    MEASURES,
    PHOTO,
    STARTS,
    Found,
    ambiguous,
    by_room,
    decimals,
    drawn_starts,
    measure_table,
    within,
)
from dirl.experiments.results import Result, Table, grouped, write_tables
from dirl.models import EpisodicMemory, PlanningMemory
from dirl.scenes import SceneError, World

THRESHOLDS = (0.8, 0.85, 0.9, 0.95, 0.98)
"""Of the matching, compared in the validation rooms."""

TESTED: Mapping[str, Any] = {
    "split": "test",
    "rooms": None,
    "goals": "all",
    "evaluation.goals": GOALS,
    "evaluation.max_steps": MAX_STEPS,
}

BOTH_VIEWS = decimals(f"{name}, {way}" for way in (FOUR, PHOTO) for name in ("SR", "SPL"))
"""Columns of SR and SPL by how the goal is shown, see `_both_views`."""


def tested(run: Result) -> tuple[World, dict[str, Episodes]]:
    """Episodes in the test rooms of the collection that a run was trained on, by what walked them."""
    loaded = run.load(TESTED), run.load(TESTED, "front")
    world, starts = loaded[0].protocol.world, drawn_starts(loaded[0].protocol.world)
    four, one = (trained._replace(protocol=replace(trained.protocol, starts=starts)) for trained in loaded)
    found = walked_by(four, one, starts)
    if isinstance(four.protocol.memory, PlanningMemory):
        for name, (_, policy, protocol) in ((FOUR, four), (PHOTO, one)):
            found[f"{name}, memory of counts"] = replace(protocol, memory=EpisodicMemory()).run(policy)
    return world, found


def report_unseen_rooms(results: Sequence[Result], out: Path, note: str) -> str:
    """Write how well goals are found in rooms that no training saw."""
    variants = grouped(results, variant)
    main = main_variant(variants)
    by_variant = {name: _tested_by_count(runs) for name, runs in ({main: variants[main]} | variants).items()}
    parts = Table({"system": "s", "training rooms": "d", "runs": "d", **BOTH_VIEWS})
    for name, tests in by_variant.items():
        count = max(tests)
        parts.add(name, count, len(tests[count]), *_both_views(tests[count]))
    curve = Table({"training rooms": "d", "runs": "d", **BOTH_VIEWS})
    for count, most in by_variant[main].items():
        curve.add(count, len(most), *_both_views(most))
    world, ways = most[0]
    table = measure_table({"walks by": "", "runs": "d"})
    far = Table({"SPL, walks by": "", **decimals(FAR)})
    for way in ways:
        table.add(way, len(most), *(_rooms(most, way, key) for key in MEASURES))
        near = [[(one, {way: within(episodes[way], *limits)}) for one, episodes in most] for limits in FAR.values()]
        far.add(way, *(_rooms(part, way, "spl") for part in near))
    _draw(most, out)
    text = (
        f"{note}\n\nTested in {len(world.scenes)} rooms of the test split, which no training saw: {STARTS} episodes of "
        f"each room and distance, at most {MAX_STEPS} steps, stop by template matching. Of several numbers: "
        "mean over rooms, in brackets its 95 % bootstrap interval over rooms, and the worst room."
    )
    tables = {"unseen_rooms": table, "unseen_rooms_by_start": far, "unseen_rooms_by_training": curve}
    tables |= {"unseen_rooms_by_kind": _by_kind(most), "unseen_rooms_parts": parts}
    if thresholds := _thresholds(results[0]):
        tables["unseen_rooms_thresholds"] = thresholds
    shown = "SR and SPL in unseen rooms: with four views, with one photo, without memory, and of controls"
    return write_tables(out, "Unseen rooms", text, tables, {"unseen_rooms": shown})


def _tested_by_count(runs: Sequence[Result]) -> dict[int, list[tuple[World, dict[str, Episodes]]]]:
    """The test of each run, by the number of rooms that it was trained in, ascending."""
    found: dict[int, list[tuple[World, dict[str, Episodes]]]] = {}
    for run in tqdm(sorted(runs, key=lambda run: len(run.scenes)), desc="unseen rooms", unit=" runs", disable=None):
        found.setdefault(len(run.scenes), []).append(tested(run))
    return found


def _by_kind(found: Found) -> Table:
    """SR and SPL in the rooms of each kind, which their names begin with."""
    names = [name.rpartition("_")[0] for name in found[0][0].names]
    table = Table({"kind": "s", "rooms": "d", **BOTH_VIEWS})
    for kind in dict.fromkeys(names):
        own = [index for index, name in enumerate(names) if name == kind]
        table.add(kind, len(own), *([cell[index] for index in own] for cell in _both_views(found)))
    return table


def _thresholds(run: Result) -> Table | None:
    """Of all goals in the validation rooms, if there are any, how many look like another state above a threshold."""
    try:
        world = run.load({**TESTED, "split": "validation", "evaluation.goals": None}).protocol.world
    except SceneError:
        return None
    table = Table({"threshold": ".2f", "goals": "d", FOUR: "d", PHOTO: "d"})
    for threshold in THRESHOLDS:
        alike = [int(ambiguous(world, threshold, match).sum()) for match in ("views", "front")]
        table.add(threshold, len(world.goals), *alike)
    return table


def _both_views(found: Found) -> list[list[float]]:
    return [_rooms(found, way, key) for way in (FOUR, PHOTO) for key in ("sr", "spl")]


def _rooms(found: Found, way: str, key: str) -> list[float]:
    """A measure in each room, the mean of the runs."""
    runs = torch.tensor([by_room(world, episodes[way], key) for world, episodes in found], dtype=torch.float64)
    return runs.mean(0).tolist()


def _draw(found: Found, out: Path) -> None:
    """SR and SPL of each way, the interquartile mean over rooms with its interval."""
    figure, grid = panels(2, (9, 3.4))
    places = list(range(len(DRAWN)))[::-1]
    for axes, key in zip(grid, ("sr", "spl"), strict=True):
        for place, (way, color) in zip(places, DRAWN.items(), strict=True):
            interval_row(axes, place, _rooms(found, way, key), color)
        axes.set_yticks(places, list(DRAWN))
        axes.set(xlabel=MEASURES[key], xlim=(-0.04, 1.04))
    save_figure(figure, out, "unseen_rooms")
