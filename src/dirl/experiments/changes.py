"""Places that change: how well goals are found where no visit looks like another, beside controls.

    python -m dirl.experiments.changes rooms_2cm rooms_5cm rooms_10cm --agents general --out reports/changes

Each collection has looks, see `dirl.rooms.looks`. What was measured is kept in the folder, so that the program goes on
where it was stopped.
"""

import argparse
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from tqdm import tqdm

from dirl.cli.command_line import one_line_errors
from dirl.config.choices import goal_view_options, group_options
from dirl.evaluation.episodes import Episodes
from dirl.evaluation.experts import RandomPolicy
from dirl.experiments.any_goal import MEASURES, wrong_goals
from dirl.experiments.results import Column, Table, save_figure, write_tables
from dirl.experiments.unseen_rooms import by_room
from dirl.reporting.statistics import bootstrap_interval, iqm
from dirl.reporting.style import plain
from dirl.runs.checkpoints import load_checkpoint
from dirl.runs.exits import one_line_exits
from dirl.scenes import World
from dirl.scenes.io.atomic import write_json
from dirl.scenes.io.texts import read_text
from dirl.scenes.palette import SYSTEM_COLORS
from dirl.training.load import load_trained

TESTED: Mapping[str, Any] = {
    "split": "test",
    "rooms": None,
    "goals": "every:8",
    "evaluation.goals": None,
    "evaluation.starts": "sampled",
    "evaluation.episodes_per_goal": 3,
    "evaluation.max_steps": 100,
}

GOAL_VIEWS = {"surrounding": "four views", "front": "one photo"}

RECOGNISED = {
    "ncc": ("ncc", "planning"),
    "patches": ("patches", "planning"),
    "learned, localising": ("learned", "localising"),
}
"""Recogniser and episodic memory, by the name of the pair in the tables."""

CONTROLS = (
    "told when it has arrived",
    "another goal's views, told",
    "sweep that ignores the goal, told",
    "random walk, told",
)
"""Each stops exactly at the goal; with the learned recogniser the memory knows places again."""


def walked(agent: str, collection: str, goal_view: str, way: str) -> tuple[World, Episodes]:
    """Episodes in the test rooms of a collection, and these rooms.

    Args:
        agent: a checkpoint.
        collection: a folder, with looks.
        goal_view: one of `GOAL_VIEWS`.
        way: one of `RECOGNISED` or `CONTROLS`.
    """
    recogniser, memory = RECOGNISED.get(way, ("learned", "planning"))
    changes = {**TESTED, "scene": f"collection:{collection}", **goal_view_options(goal_view)}
    changes |= {"stop.threshold": 0.95, "stop.evaluation": "goal" if way in CONTROLS else "match"}
    chosen = {"recogniser": recogniser, "episodic_memory": memory}
    changes |= {group: group_options(group, choice) for group, choice in chosen.items()}
    _, policy, protocol = load_trained(load_checkpoint(agent), agent, changes)
    world = protocol.world
    if way == CONTROLS[1]:
        return world, replace(protocol, shown=wrong_goals(world)).run(policy)
    if way == CONTROLS[2]:
        return world, protocol.run(RandomPolicy(), greedy=True)
    if way == CONTROLS[3]:
        return world, replace(protocol, memory=None).run_random()
    return world, protocol.run(policy)


def measured(out: Path, agent: str, collection: str, goal_view: str, way: str) -> dict[str, list[float]]:
    """`MEASURES` of each room; from the folder, if they were measured before."""
    stem = "-".join(
        part.replace(", ", "_").replace(" ", "_") for part in (Path(agent).name, Path(collection).name, way)
    )
    file = out / "measured" / f"{stem}-{goal_view}.json"
    if not file.exists():
        world, episodes = walked(agent, collection, goal_view, way)
        file.parent.mkdir(parents=True, exist_ok=True)
        write_json(file, {key: by_room(world, episodes, key) for key in MEASURES})
    found: dict[str, list[float]] = json.loads(read_text(file))
    return found


def report_changes(collections: list[str], agents: list[str], out: Path) -> str:
    """Measure, and write tables and a figure; returns the text of the README.

    Args:
        collections: folders, in the order of the strength of the changes.
        agents: checkpoints; the controls are of the first.
        out: a folder.
    """
    of_agent = [(agent, way) for agent in agents for way in RECOGNISED]
    ways = [*of_agent, *((agents[0], way) for way in CONTROLS)]
    cases = [(one, view, *way) for one in collections for view in GOAL_VIEWS for way in ways]
    found = {}
    for collection, view, agent, way in tqdm(cases, desc="changes", unit=" cases", disable=None):
        found[collection, view, agent, way] = measured(out, agent, collection, view, way)
    table = Table(
        *(Column(name) for name in ("rooms", "goal", "agent", "recogniser")),
        *(Column(name, ".3f") for name in MEASURES.values()),
    )
    for (collection, view, agent, way), values in found.items():
        names = Path(collection).name, GOAL_VIEWS[view], Path(agent).name, way
        table.add(*names, *(values[key] for key in MEASURES))
    _draw(found, collections, of_agent, agents[0], out)
    note = (
        "Test rooms, **synthetic, not AI2-THOR**, which no training saw; three starts for every eighth state as the "
        "goal, 100 steps. Interquartile mean over rooms and, in brackets, its 95 % bootstrap interval over rooms."
    )
    shown = "SPL of each recogniser over the strength of the changes, with four views and with one photo"
    return write_tables(out, "Places that change", note, {"changes": table}, {"changes": shown})


def _draw(
    found: Mapping[Any, Mapping[str, list[float]]],
    collections: list[str],
    ways: list[tuple[str, str]],
    first: str,
    out: Path,
) -> None:
    """SPL over the collections, a line for each agent and recogniser, and the controls in grey."""
    figure = Figure(figsize=(8, 4.6), layout="constrained")
    colors = list(SYSTEM_COLORS.values())
    lines = [(*way, colors[index % len(colors)], "o-") for index, way in enumerate(ways)]
    lines += [(first, way, "0.6", marker) for way, marker in zip(CONTROLS, ("o-", "s--", "^:", "v:"), strict=True)]
    for axes, view in zip(figure.subplots(1, 2, sharey=True), GOAL_VIEWS, strict=True):
        for agent, way, color, marker in lines:
            spl = [found[collection, view, agent, way]["spl"] for collection in collections]
            mean = [float(iqm(values)) for values in spl]
            low, high = zip(*(bootstrap_interval(values) for values in spl), strict=True)
            error = [[m - float(a) for m, a in zip(mean, low, strict=True)]]
            error += [[float(b) - m for m, b in zip(mean, high, strict=True)]]
            label = way if way in CONTROLS else f"{Path(agent).name}: {way}"
            named = label if view == "surrounding" else None
            axes.errorbar(range(len(spl)), mean, error, fmt=marker, color=color, markersize=3.5, capsize=2, label=named)
        axes.set_xticks(range(len(collections)), [Path(one).name for one in collections])
        axes.set(title=GOAL_VIEWS[view], ylim=(-0.03, 1.03), ylabel="SPL" if view == "surrounding" else None)
        axes.tick_params(axis="x", labelsize="small")
        plain(axes)
    figure.legend(loc="outside lower center", ncols=3, frameon=False)
    save_figure(figure, out, "changes")


def main() -> None:
    """The program."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("collections", nargs="+", help="folders made by scenes.py sample looks=...")
    parser.add_argument("--agents", nargs="+", default=["general"], help="checkpoints; the controls are of the first")
    parser.add_argument("--out", type=Path, default=Path("reports/changes"))
    options = parser.parse_args()
    with one_line_exits(), one_line_errors():
        print(report_changes(options.collections, options.agents, options.out))


if __name__ == "__main__":
    main()
