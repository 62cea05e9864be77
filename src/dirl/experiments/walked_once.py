"""Walk once, come back later: maps of places that change, and goals found with them.

    python -m dirl.experiments.walked_once rooms_2cm rooms_5cm --out reports/walked_once
    python -m dirl.experiments.walked_once rooms_2cm rooms_2cm:later_lit --out reports/walked_once

Each argument is a collection with looks, see `dirl.rooms.looks`, or two of the same rooms: the walk sees the first one,
the later episodes see the further looks of the second, in which furniture may have moved. What was measured is kept in
the folder, so that the program goes on where it was stopped.
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib.figure import Figure
from torch import Tensor
from tqdm import tqdm

from dirl.agent.exploring import Guide
from dirl.agent.mapping import ImageGraph
from dirl.cli.command_line import one_line_errors
from dirl.config.choices import goal_view_options, group_options
from dirl.evaluation.episodes import Episodes, drawn_looks
from dirl.evaluation.maps import map_quality, map_scene, walk_through
from dirl.evaluation.protocol import EvaluationProtocol
from dirl.experiments.any_goal import MEASURES, wrong_goals
from dirl.experiments.changes import GOAL_VIEWS, TESTED
from dirl.experiments.results import Column, Table, save_figure, write_tables
from dirl.experiments.unseen_rooms import by_room
from dirl.models import LocalisingMemory
from dirl.recognition.recogniser import normal_vectors
from dirl.reporting.statistics import bootstrap_interval, iqm
from dirl.reporting.style import plain
from dirl.runs.checkpoints import load_checkpoint
from dirl.runs.checks import RunError
from dirl.runs.exits import one_line_exits
from dirl.scenes import World, read_dump
from dirl.scenes.collection import read_collection
from dirl.scenes.io.atomic import write_json
from dirl.scenes.io.texts import read_text
from dirl.scenes.io.write import copy_with
from dirl.scenes.palette import BLUE, GREEN, GREY, ORANGE
from dirl.training.load import Trained, load_trained

STEPS = 3.0
"""Of a walk at most, for each state of the room."""

MAPPED, ALONE, CONTROL, GRAPH = "map of the walk", "no map", "map, another goal's views", "image graph, ncc"
WAYS = {MAPPED: BLUE, ALONE: GREEN, GRAPH: ORANGE, CONTROL: GREY}

SIMILAR, ARRIVED = 0.8, {"surrounding": 0.9, "front": 0.95}
"""Correlation above which a topological map merges nodes, as its guide advises where views change, and stops."""

QUALITY = {"nodes": "nodes a state", "covered": "states seen", "wrong": "wrong links"}


def rooms(collection: str, folder: Path) -> tuple[list[str], range | None, range | None]:
    """The dumps of the test rooms, and the looks of the walk and of the episodes; None are all.

    Args:
        collection: a folder, or two with a colon between them.
        folder: where dumps with the looks of both are written.

    Raises:
        RunError: the two are not of the same rooms.
    """
    first, _, later = collection.partition(":")
    before = read_collection(first)
    names = [entry.name for entry in before.entries if entry.split == "test"]
    if not later:
        return [str(Path(first) / f"{name}.h5") for name in names], None, None
    files, seen, looks = [], 1, 1
    for name in names:
        one, other = (read_dump(Path(place) / f"{name}.h5") for place in (first, later))
        if len(one) != len(other) or not np.array_equal(one.graph, other.graph):
            raise RunError(f"{later}: {name} is another room than in {first}; make both with the same kind and seed")
        if one.look_features is None or other.look_features is None:
            raise RunError(f"{collection}: {name} has no looks in one of them; make both with looks=2")
        arrays = {"look_feature": np.concatenate([one.look_features, other.look_features])}
        if one.look_patches is not None and other.look_patches is not None:
            arrays["look_patches"] = np.concatenate([one.look_patches, other.look_patches])
        file = folder / f"{name}.h5"
        copy_with(Path(first) / f"{name}.h5", file, arrays, {key: {} for key in arrays})
        files.append(str(file))
        seen, looks = one.looks, one.looks + len(other.look_features)
    return files, range(seen), range(seen, looks)


Measured = dict[str, dict[str, list[float]]]


def measured(agent: str, collection: str, out: Path) -> Measured:
    """Measures of each room, by goal view and way; from the folder, if they were measured before."""
    stem = f"{Path(agent).name}-{'-'.join(Path(part).name for part in collection.split(':'))}"
    file = out / "measured" / f"{stem}.json"
    if not file.exists():
        found = measure(agent, *rooms(collection, out / "rooms" / stem))
        file.parent.mkdir(parents=True, exist_ok=True)
        write_json(file, found)
    kept: Measured = json.loads(read_text(file))
    return kept


def measure(
    agent: str, files: list[str], before: range | None, after: range | None
) -> dict[str, dict[str, list[float]]]:
    """Walk through each room, and go to goals in it with and without the map; see `measured`."""
    found: Measured = {}
    maps = None
    for view in GOAL_VIEWS:
        _, policy, protocol = _loaded(agent, files, view)
        world, memory, scores = protocol.world, protocol.memory, protocol.scores
        assert isinstance(memory, LocalisingMemory)
        assert scores is not None
        if maps is None:
            walks = [map_scene(world, i, memory, scores, STEPS, 0, before) for i in range(len(world.scenes))]
            maps = [known for known, _ in walks]
            qualities = [map_quality(*walk, world, index) for index, walk in enumerate(walks)]
            found[MAPPED] = {key: [getattr(one, key) for one in qualities] for key in QUALITY}
            graphs, found[GRAPH] = image_graphs(world, before)
        later = replace(protocol, looks=after)
        known = replace(later, maps=maps)
        shown, states, arrived = wrong_goals(world), len(world.goals), protocol.stop
        assert callable(arrived)

        def other(wanted: Tensor, seen: Tensor) -> Tensor:
            return arrived(shown[wanted % states] + wanted // states * states, seen)  # noqa: B023

        ways = {
            MAPPED: known.run(policy),
            ALONE: later.run(policy),
            CONTROL: replace(known, stop=other).run(policy),
            GRAPH: by_image_graphs(graphs, later, view),
        }
        for way, episodes in ways.items():
            found[f"{view}: {way}"] = {key: by_room(world, episodes, key) for key in MEASURES}
    return found


def _loaded(agent: str, files: list[str], view: str) -> Trained:
    changes: dict[str, Any] = {**TESTED, "split": None, "scene": files, **goal_view_options(view)}
    changes |= {"stop.threshold": 0.95, "stop.evaluation": "match"}
    chosen = {"recogniser": "learned", "episodic_memory": "localising"}
    return load_trained(
        load_checkpoint(agent), agent, changes | {group: group_options(group, one) for group, one in chosen.items()}
    )


def image_graphs(world: World, looks: range | None) -> tuple[list[ImageGraph], dict[str, list[float]]]:
    """A topological map of a walk through each room, by correlation, and how many nodes it has for each state."""
    graphs, nodes = [], []
    for index in range(len(world.scenes)):
        graph = ImageGraph(SIMILAR)
        passed = walk_through(world, index, graph, lambda visit: world.features[visit].cpu(), STEPS, 0, looks)
        seen = torch.tensor(world.scenes[index].surrounding)[torch.tensor(passed)].unique()
        graphs.append(graph)
        nodes.append(len(graph) / len(seen))
    return graphs, {"nodes": nodes}


def by_image_graphs(graphs: Sequence[ImageGraph], protocol: EvaluationProtocol, view: str) -> Episodes:
    """Episodes that are led by topological maps to the end; where one knows no path, the agent acts at random."""
    world, (goal_index, start) = protocol.world, protocol.starts
    generator = torch.Generator().manual_seed(protocol.seed)
    wanted = drawn_looks(goal_index, len(world.goals), world, generator, looks=protocol.looks)
    found = []
    for goal, begin in zip(wanted.tolist(), start.tolist(), strict=True):
        state, look = int(world.goals[goal % len(world.goals)]), goal // len(world.goals)
        shown = world.surrounding[state] + look * len(world)
        features = world.features[shown if view == "surrounding" else shown[:1]]
        guide = Guide(graphs[int(world.scene_of[begin])], features, 0)
        found.append(_led(guide, features, protocol, begin, state, torch.tensor([look]), generator, ARRIVED[view]))
    steps, stopped, missed = (torch.tensor(column) for column in zip(*found, strict=True))
    at = torch.tensor([bool(one) for one in stopped]) & (steps[:, 1] == 1)
    end = stopped.bool()
    taken = torch.where(at, steps[:, 0], protocol.max_steps)
    return Episodes(goal_index, start, world.distance(goal_index, start), taken, at, end & ~at, missed.bool())


def _led(
    guide: Guide,
    goal: Tensor,
    protocol: EvaluationProtocol,
    state: int,
    target: int,
    look: Tensor,
    generator: torch.Generator,
    threshold: float,
) -> tuple[tuple[int, int], bool, bool]:
    """One episode: the steps and whether it ended at the goal, whether the agent stopped, and missed to."""
    world, missed = protocol.world, False
    for taken in range(protocol.max_steps + 1):
        ahead = drawn_looks(torch.tensor([state]), len(world), world, generator, look, protocol.looks)
        views = world.features[world.surrounding[state] + (ahead - ahead % len(world))].float()
        alike = float(normal_vectors(views[: len(goal)].flatten()) @ normal_vectors(goal.float().flatten()))
        if taken and alike > threshold:
            return (taken, int(state == target)), True, missed
        missed |= bool(taken) and state == target
        action = guide.advise(views)
        guide.action = int(torch.randint(4, (), generator=generator)) if action is None else action
        state = int(world.graph[state, guide.action])
    return (protocol.max_steps, 0), False, missed


def report_walked_once(collections: list[str], agent: str, out: Path) -> str:
    """Measure, and write tables and a figure; returns the text of the README."""
    bar = tqdm(collections, desc="walked once", unit=" collections", disable=None)
    found = {collection: measured(agent, collection, out) for collection in bar}
    maps = Table(Column("rooms"), Column("map"), *(Column(name, ".3f") for name in QUALITY.values()))
    goals = Table(Column("rooms"), Column("goal"), Column("way"), *(Column(name, ".3f") for name in MEASURES.values()))
    for collection, of in found.items():
        maps.add(_name(collection), MAPPED, *(of[MAPPED][key] for key in QUALITY))
        maps.add(_name(collection), GRAPH, of[GRAPH]["nodes"], None, None)
        for view, shown in GOAL_VIEWS.items():
            for way in WAYS:
                goals.add(_name(collection), shown, way, *(of[f"{view}: {way}"][key] for key in MEASURES))
    _draw(found, out)
    note = (
        "Test rooms, **synthetic, not AI2-THOR**, which no training saw; one walk of at most three steps for each "
        "state, then three starts for every eighth state as the goal, 100 steps. Interquartile mean over rooms and, in "
        "brackets, its 95 % bootstrap interval over rooms."
    )
    shown = "SPL with and without the map of one walk, by how the rooms have changed since"
    return write_tables(out, "Walked once", note, {"maps": maps, "walked_once": goals}, {"walked_once": shown})


def _name(collection: str) -> str:
    return " then ".join(Path(part).name for part in collection.split(":"))


def _draw(found: Mapping[str, Measured], out: Path) -> None:
    """SPL of each way in each collection, as points with intervals."""
    figure = Figure(figsize=(8, 4.6), layout="constrained")
    for axes, (view, shown) in zip(figure.subplots(1, 2, sharey=True), GOAL_VIEWS.items(), strict=True):
        for step, (way, color) in enumerate(WAYS.items()):
            spl = [of[f"{view}: {way}"]["spl"] for of in found.values()]
            mean = np.array([float(iqm(values)) for values in spl])
            low, high = np.array([bootstrap_interval(values) for values in spl]).T
            named = way if view == "surrounding" else None
            error = np.maximum(0.0, [mean - low, high - mean])
            beside = np.arange(len(spl)) + 0.15 * (step - 1.5)
            axes.errorbar(beside, mean, error, fmt="o", color=color, markersize=4, capsize=2, label=named)
        names = [Path(collection.split(":")[-1]).name for collection in found]
        axes.set_xticks(range(len(names)), names, rotation=30, ha="right")
        axes.set(title=shown, ylim=(-0.03, 1.03), ylabel="SPL" if view == "surrounding" else None)
        axes.tick_params(axis="x", labelsize="small")
        plain(axes)
    figure.legend(loc="outside lower center", ncols=4, frameon=False)
    save_figure(figure, out, "walked_once")


def main() -> None:
    """The program."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("collections", nargs="+", help="folders, or two of the same rooms with a colon between them")
    parser.add_argument("--agent", default="general", help="a checkpoint, or an agent of the package")
    parser.add_argument("--out", type=Path, default=Path("reports/walked_once"))
    options = parser.parse_args()
    with one_line_exits(), one_line_errors():
        print(report_walked_once(options.collections, options.agent, options.out))


if __name__ == "__main__":
    main()
