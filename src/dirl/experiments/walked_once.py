"""Walk once, come back later: maps of places that change, and goals found with them.

A collection with looks (see `dirl.sources.rooms.looks`) is named by its folder, or two of the same rooms with a colon
between them: then the walk sees the first one, and the later episodes see the further looks of the second, in which
furniture may have moved.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from dirl.agent.mapping import ImageGraph
from dirl.agent.mapping.policy import Guide
from dirl.evaluation.episodes import Episodes, drawn_looks
from dirl.evaluation.maps import map_quality, map_scene, walk_through
from dirl.evaluation.protocol import EvaluationProtocol
from dirl.experiments.changes import GOAL_VIEWS, TESTED, Measured
from dirl.experiments.figures import draw_spl
from dirl.experiments.measures import MEASURES, by_measure, decimals, kept, load_agent, measure_table, wrong_goals
from dirl.experiments.results import Table, write_tables
from dirl.models import LocalisingMemory
from dirl.perception.recognition.recogniser import normal_vectors
from dirl.runs.finding import RunError
from dirl.scenes import World, read_dump
from dirl.scenes.collection import read_collection
from dirl.scenes.io.write import copy_with
from dirl.scenes.palette import BLUE, GREEN, GREY, ORANGE
from dirl.training.load import Trained

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
    names = [entry.name for entry in read_collection(first).entries if entry.split == "test"]
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


def measured(agent: str, collection: str, out: Path) -> dict[str, Measured]:
    """Measures of each room, by goal view and way; from the folder, if they were measured before."""
    stem = f"{Path(agent).name}-{'-'.join(Path(part).name for part in collection.split(':'))}"
    found: dict[str, Measured] = kept(
        out / "measured" / f"{stem}.json", lambda: measure(agent, *rooms(collection, out / "rooms" / stem))
    )
    return found


def measure(agent: str, files: list[str], before: range | None, after: range | None) -> dict[str, Measured]:
    """Walk through each room, and go to goals in it with and without the map; see `measured`."""
    found: dict[str, Measured] = {}
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
        found |= {f"{view}: {way}": by_measure(world, episodes) for way, episodes in ways.items()}
    return found


def _loaded(agent: str, files: list[str], view: str) -> Trained:
    changes = {**TESTED, "split": None, "scene": files}
    return load_agent(agent, changes, view, recogniser="learned", episodic_memory="localising")


def image_graphs(world: World, looks: range | None) -> tuple[list[ImageGraph], Measured]:
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
    steps, end, stopped, missed = (torch.tensor(column) for column in zip(*found, strict=True))
    success = stopped & (end == world.goals[goal_index])
    taken = torch.where(success, steps, protocol.max_steps)
    shortest = world.distance(goal_index, start)
    return Episodes(goal_index, start, shortest, taken, success, stopped & ~success, missed)


def _led(
    guide: Guide,
    goal: Tensor,
    protocol: EvaluationProtocol,
    state: int,
    target: int,
    look: Tensor,
    generator: torch.Generator,
    threshold: float,
) -> tuple[int, int, bool, bool]:
    """One episode: the steps, the last state, whether the agent stopped there, and whether it missed to at the goal."""
    world, missed = protocol.world, False
    for taken in range(protocol.max_steps + 1):
        ahead = drawn_looks(torch.tensor([state]), len(world), world, generator, look, protocol.looks)
        views = world.features[world.surrounding[state] + (ahead - ahead % len(world))].float()
        alike = float(normal_vectors(views[: len(goal)].flatten()) @ normal_vectors(goal.float().flatten()))
        if taken and alike > threshold:
            return taken, state, True, missed
        missed |= bool(taken) and state == target
        action = guide.advise(views)
        guide.action = int(torch.randint(4, (), generator=generator)) if action is None else action
        state = int(world.graph[state, guide.action])
    return protocol.max_steps, state, False, missed


def report_walked_once(collections: Sequence[str], agent: str, out: Path) -> str:
    """Measure, and write tables and a figure. What was measured is kept in the folder, and not measured again.

    Args:
        collections: folders, or two of the same rooms with a colon between them.
        agent: that walks.
        out: a folder; what was measured is kept in it, and not measured again.
    """
    bar = tqdm(collections, desc="walked once", unit=" collections", disable=None)
    found = {collection: measured(agent, collection, out) for collection in bar}
    maps = Table({"rooms": "", "map": "", **decimals(QUALITY.values())})
    goals = measure_table({"rooms": "", "goal": "", "way": ""})
    for collection, of in found.items():
        name = " then ".join(Path(part).name for part in collection.split(":"))
        maps.add(name, MAPPED, *(of[MAPPED][key] for key in QUALITY))
        maps.add(name, GRAPH, of[GRAPH]["nodes"], None, None)
        for view, shown in GOAL_VIEWS.items():
            for way in WAYS:
                goals.add(name, shown, way, *(of[f"{view}: {way}"][key] for key in MEASURES))
    lines = []
    for way, color in WAYS.items():
        spl = {shown: [of[f"{view}: {way}"]["spl"] for of in found.values()] for view, shown in GOAL_VIEWS.items()}
        lines.append((way, color, "o", spl))
    draw_spl(lines, [Path(one.split(":")[-1]).name for one in collections], out, "walked_once", apart=0.15)
    note = (
        "Test rooms, **synthetic, not AI2-THOR**, which no training saw; one walk of at most three steps for each "
        "state, then three starts for every eighth state as the goal, 100 steps. Interquartile mean over rooms and, in "
        "brackets, its 95 % bootstrap interval over rooms."
    )
    drawn = "SPL with and without the map of one walk, by how the rooms have changed since"
    return write_tables(out, "Walked once", note, {"maps": maps, "walked_once": goals}, {"walked_once": drawn})
