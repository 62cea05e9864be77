"""Walk once, come back later: maps of places that change, and goals found with them.

A collection with looks (see `dirl.sources.rooms.looks`) is named by its folder, or several of the same rooms with
colons between them: then the walk sees the first one, and the later episodes see the further looks of the second, in
which furniture may have moved. The looks of a third one are those of the goals, photos that another camera took; if the
second one is empty (``rooms::photos``), the episodes see the looks of the walk.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import accumulate, pairwise
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
from dirl.runs.paths import RunError
from dirl.scenes import World, read_dump
from dirl.scenes.collection import read_collection
from dirl.scenes.graph import places
from dirl.scenes.io.write import copy_with
from dirl.scenes.palette import BLUE, GREEN, GREY, ORANGE
from dirl.training.build import Trained

STEPS = 3.0
"""Of a walk at most, for each state of the room."""

MAPPED, ALONE, CONTROL, GRAPH = "map of the walk", "no map", "map, another goal's views", "image graph, ncc"
WAYS = {MAPPED: BLUE, ALONE: GREEN, GRAPH: ORANGE, CONTROL: GREY}

SIMILAR, ARRIVED = 0.8, {"surrounding": 0.9, "front": 0.95}
"""Correlation above which a topological map merges nodes, as its guide advises where views change, and stops."""

PLACES = "stops at the place"
"""Facing any way: a photo that is turned aside shows the views of two headings alike."""

QUALITY = {"nodes": "nodes a state", "covered": "states seen", "wrong": "wrong links"}


def rooms(collection: str, out: Path) -> tuple[list[str], list[range | None]]:
    """The dumps of the test rooms, and the looks of the walk, of the episodes and of their goals; None are all.

    Of several folders, with colons between them, dumps with the looks of all are written to ``out``.

    Raises:
        RunError: they are not of the same rooms.
    """
    parts = collection.split(":")
    folders = [Path(part) for part in parts if part]
    first = folders[0]
    names = [entry.name for entry in read_collection(first).entries if entry.split == "test"]
    if len(parts) == 1:
        return [str(first / f"{name}.h5") for name in names], [None, None, None]
    files, counts = [], [0] * len(folders)
    for name in names:
        dumps = [read_dump(folder / f"{name}.h5") for folder in folders]
        for dump, place in zip(dumps, folders, strict=True):
            if len(dump) != len(dumps[0]) or not np.array_equal(dump.graph, dumps[0].graph):
                raise RunError(f"{place}: {name} is another room than in {first}; make both of one kind and seed")
            if dump.look_features is None:
                raise RunError(f"{place}: {name} has no looks; make it with looks=2")
        arrays = {"look_feature": np.concatenate([dump.look_features for dump in dumps])}
        if all(dump.look_patches is not None for dump in dumps):
            shapes = {dump.look_patches.shape[2:] for dump in dumps}
            if len(shapes) > 1:
                raise RunError(f"{collection}: {name} has patches of {len(shapes)} kinds; encode all folders alike")
            arrays["look_patches"] = np.concatenate([dump.look_patches for dump in dumps])
        file = out / f"{name}.h5"
        copy_with(first / f"{name}.h5", file, arrays, {key: {} for key in arrays})
        files.append(str(file))
        counts = [dumps[0].looks, *(dump.looks - 1 for dump in dumps[1:])]  # of others the default look is left out
    looks = [range(*ends) for ends in pairwise(accumulate(counts, initial=0))]
    if not parts[1]:
        looks.insert(1, looks[0])
    return files, [*looks, *[None] * (3 - len(looks))]


def measured(agent: str, collection: str, out: Path) -> dict[str, Measured]:
    """Measures of each room, by goal view and way; from the folder, if they were measured before."""
    stem = f"{Path(agent).name}-{'-'.join(Path(part).name for part in collection.split(':'))}"
    file = out / "measured" / f"{stem}.json"
    return kept(file, lambda: measure(agent, *rooms(collection, out / "rooms" / stem)))


def measure(agent: str, files: list[str], looks: Sequence[range | None]) -> dict[str, Measured]:
    """Walk through each room, and go to goals in it with and without the map; see `measured`."""
    before, after, photos = looks
    found: dict[str, Measured] = {}
    maps = scores = None
    for view in ("front",) if photos else GOAL_VIEWS:
        _, policy, protocol = _loaded(agent, files, view)
        scores = scores or protocol.scores  # the memory compares four views, however the goal is shown
        world, memory = protocol.world, protocol.memory
        assert isinstance(memory, LocalisingMemory)
        assert scores is not None
        if maps is None:
            walks = [map_scene(world, i, memory, scores, STEPS, 0, before) for i in range(len(world.scenes))]
            maps = [known for known, _ in walks]
            qualities = [map_quality(*walk, world, index) for index, walk in enumerate(walks)]
            found[MAPPED] = {key: [getattr(one, key) for one in qualities] for key in QUALITY}
            if not photos:
                graphs, found[GRAPH] = image_graphs(world, before)
        later = replace(protocol, scores=scores, looks=after, photos=photos)
        known = replace(later, maps=maps)
        shown, states, arrived = wrong_goals(world), len(world.goals), protocol.stop
        assert callable(arrived)

        def other(wanted: Tensor, seen: Tensor) -> Tensor:
            return arrived(shown[wanted % states] + wanted // states * states, seen)  # noqa: B023

        ways = {CONTROL: replace(known, stop=other).run(policy)}
        if photos:
            ways[MAPPED], paths = known.trajectories(policy, known.starts)
            found[PLACES] = {PLACES: stops_at_places(world, ways[MAPPED], paths)}
        else:
            ways[MAPPED], ways[ALONE] = known.run(policy), later.run(policy)
            ways[GRAPH] = by_image_graphs(graphs, later, view)
        found |= {f"{view}: {way}": by_measure(world, episodes) for way, episodes in ways.items()}
    return found


def stops_at_places(world: World, episodes: Episodes, paths: Sequence[Sequence[int]]) -> list[float]:
    """In each room the fraction of episodes that end by a stop at the goal's place, facing any way."""
    place = torch.cat([torch.from_numpy(places(scene.graph)) for scene in world.scenes])
    end, goal = torch.tensor([path[-1] for path in paths]), world.goals[episodes.goal_index]  # of one room
    there = (episodes.success | episodes.false_stop) & (place[end] == place[goal])
    room = world.scene_of[episodes.start]
    return [float(there[room == index].double().mean()) for index in room.unique().tolist()]


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

    Collections are folders, or several of the same rooms with colons between them.
    """
    bar = tqdm(collections, desc="walked once", unit=" collections", disable=None)
    found = {collection: measured(agent, collection, out) for collection in bar}
    names = {one: " then ".join(Path(part).name for part in one.split(":") if part) for one in found}
    tables = {
        "maps": Table({"rooms": "", "map": "", **decimals(QUALITY.values())}),
        "walked_once": measure_table({"rooms": "", "goal": "", "way": ""}),
        "photos": Table({"rooms": "", "way": "", **decimals([*MEASURES.values(), PLACES])}),
    }
    drawn = [one for one in found if PLACES not in found[one]]
    for collection, of in found.items():
        name = names[collection]
        tables["maps"].add(name, MAPPED, *(of[MAPPED][key] for key in QUALITY))
        if collection in drawn:
            tables["maps"].add(name, GRAPH, of[GRAPH]["nodes"], None, None)
            for view, shown in GOAL_VIEWS.items():
                for way in WAYS:
                    tables["walked_once"].add(name, shown, way, *_measures(of[f"{view}: {way}"]))
        else:
            for way, at_place in {MAPPED: of[PLACES][PLACES], CONTROL: None}.items():
                tables["photos"].add(name, way, *_measures(of[f"front: {way}"]), at_place)
    lines = []
    for way, color in WAYS.items():
        spl = {goal: [found[one][f"{view}: {way}"]["spl"] for one in drawn] for view, goal in GOAL_VIEWS.items()}
        lines.append((way, color, "o", spl))
    if drawn:
        draw_spl(lines, [Path(one.split(":")[-1]).name for one in drawn], out, "walked_once", apart=0.15)
    note = (
        "Test rooms, **synthetic, not AI2-THOR**, which no training saw; one walk of at most three steps for each "
        "state, then three starts for every eighth state as the goal, 100 steps. Mean over rooms, in brackets its 95 % "
        "bootstrap interval over rooms, and the worst room."
    )
    figures = {"walked_once": "SPL with and without the map of one walk, by how the rooms have changed since"}
    return write_tables(
        out, "Walked once", note, {name: one for name, one in tables.items() if one.rows}, figures if drawn else {}
    )


def _measures(of: Measured) -> list[list[float]]:
    return [of[key] for key in MEASURES]
