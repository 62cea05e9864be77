"""What false loop closures cost: topological maps of disturbed views, and of rooms with perceptual aliasing.

    python -m dirl.experiments.wrong_merges my_rooms --rooms 4 --out reports/wrong_merges

The argument is a collection of rooms (``scenes.py sample``); those of its validation split are walked through. Each
view that the walker sees is disturbed anew, as in the stop experiment (`dirl.experiments.stopping`), with a strength
sampled between nothing and the named one; the views of goals are not. Or a fraction of the places looks exactly like
another place each, in all directions (twins). The map alone decides what to do, and when to stop.
"""

import argparse
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from matplotlib.figure import Figure
from torch import Tensor

from dirl.agent.exploring import Guide
from dirl.agent.mapping import ImageGraph
from dirl.agent.mapping.looks import UNKNOWN, VIEWS
from dirl.agent.mapping.walks import looks, step
from dirl.backbones import ViewEncoder, encode_views, load_encoder
from dirl.cli.command_line import one_line_errors
from dirl.experiments.image_graph import drawn_goals, positive
from dirl.experiments.results import Column, Table, save_figure, write_tables
from dirl.experiments.stopping import DISTURBANCES, disturb
from dirl.experiments.unseen_rooms import MAX_STEPS, drawn_starts
from dirl.reporting.style import plain
from dirl.runs.exits import one_line_exits
from dirl.scenes import Scene, World
from dirl.scenes.collection import read_collection
from dirl.scenes.palette import COLORS

VARIANTS = ((0.9, False), (0.8, True), (0.9, True), (0.95, True))
"""Thresholds, and whether a match is verified."""

SHOWN = 0.9
"""The threshold of the first table."""

DRAWS = 2
"""How often each view is disturbed; of the four views of each observation one is sampled."""

STARTS = 8
"""Episodes of each room and distance."""

TWINS = (0.05, 0.1, 0.2, 0.4)
"""Shares of places that look like another one."""

KINDS = ("twins", *DISTURBANCES)

WALK = 2
"""Steps for each state of the room, at most."""

MEASURES = ("SR", "SPL", "located", "wrong links", "nodes a state")

Look = Callable[[int], Tensor]

Measured = dict[tuple[str, float, float, bool], dict[str, float]]
"""By disturbance, its strength, threshold, and whether matches are verified."""


class Place(NamedTuple):
    """A room with its goals and starts, and what a walker sees there."""

    scene: Scene
    clean: Tensor
    """Features of the views as they are, float32 ``[N, D]``."""
    pairs: list[tuple[int, int]]
    """The goal and the start of each episode, states."""
    look: Look
    """What is seen around a state, float32 ``[4, D]``; it may be another one each time."""


def disturbed_looks(scene: Scene, encoder: ViewEncoder, kind: str, strength: float) -> Look:
    """Looks whose views are disturbed by strengths up to this one, sampled for each look."""
    assert scene.views is not None
    generator, views = np.random.default_rng(0), scene.views
    seen = (
        disturb(views[state], kind, strength * generator.uniform(), generator)
        for _ in range(DRAWS)
        for state in range(len(scene))
    )
    features = torch.from_numpy(encode_views(encoder, seen, DRAWS * len(scene), scene.origin)).view(
        DRAWS, len(scene), -1
    )
    surrounding = torch.tensor(scene.surrounding)
    return lambda state: features[torch.from_numpy(generator.integers(DRAWS, size=VIEWS)), surrounding[state]]


def twin_looks(scene: Scene, clean: Tensor, share: float, kept: set[int]) -> Look:
    """Looks where a fraction of the places shows what another one does; ``kept`` states are in neither of them."""
    place = np.unique(scene.positions, axis=0, return_inverse=True)[1].ravel()
    states = [np.flatnonzero(place == one) for one in range(place.max() + 1)]
    free = np.array([one for one, inside in enumerate(states) if not kept & set(inside.tolist())])
    drawn = np.random.default_rng(0).permutation(free)
    shown, count = np.arange(len(scene)), min(round(share * len(states)), len(drawn) // 2)
    by_heading = [inside[np.argsort(scene.headings[inside])] for inside in states]
    for one, other in zip(drawn[:count], drawn[count : 2 * count], strict=True):
        shown[by_heading[one]] = by_heading[other]
    return looks(scene, clean[torch.from_numpy(shown)])


def conditions(world: World, encoder: ViewEncoder, kinds: Sequence[str]) -> Iterator[tuple[str, float, list[Place]]]:
    """What is done, how much, and the rooms under it."""
    pairs: list[list[tuple[int, int]]] = [[] for _ in world.scenes]
    for goal, start in zip(*(drawn.tolist() for drawn in drawn_starts(world, STARTS)), strict=True):
        index, offset = int(world.scene_of[start]), world.offsets[int(world.scene_of[start])]
        pairs[index].append((int(world.goals[goal]) - offset, start - offset))
    clean = [torch.tensor(scene.features).float() for scene in world.scenes]
    rooms = list(zip(world.scenes, clean, pairs, strict=True))
    yield "none", 0.0, [Place(scene, views, own, looks(scene, views)) for scene, views, own in rooms]
    for share in TWINS if "twins" in kinds else ():
        kept = [{goal for goal, _ in own} for own in pairs]
        made = [twin_looks(scene, views, share, goals) for (scene, views, _), goals in zip(rooms, kept, strict=True)]
        yield "twins", share, [Place(*room, look) for room, look in zip(rooms, made, strict=True)]
    for kind in (kind for kind in DISTURBANCES if kind in kinds):
        for strength in DISTURBANCES[kind][1][1::2]:
            yield kind, strength, [Place(*room, disturbed_looks(room[0], encoder, kind, strength)) for room in rooms]


class Traced(ImageGraph):
    """A map of which we know, and the walker does not, in which state each panorama was seen."""

    def __init__(self, threshold: float, *, verify: bool) -> None:
        super().__init__(threshold, verify=verify)
        self.state, self.states = 0, list[int]()

    def add_station(self, views: Tensor) -> int:
        """A new panorama in the present state."""
        self.states.append(self.state)
        return super().add_station(views)

    def merge_stations(self, same: Mapping[int, int]) -> None:
        """The last panoramas are forgotten."""
        super().merge_stations(same)
        del self.states[len(self) // VIEWS :]


def mapped(place: Place, graph: Traced) -> Tensor:
    """Walk through a room from `Traced.state` on, and map it; the true state of each node, int64 ``[N']``."""
    graph.see(place.look(graph.state))
    for _ in range(WALK * len(place.scene)):
        assert graph.at is not None
        action = graph.frontier_action()
        if action is None:
            break
        graph.state = step(place.scene.graph, graph.state, action)
        graph.see(place.look(graph.state), action)
    graph.lose()
    return torch.tensor(place.scene.surrounding)[graph.states].flatten()


def wrong_links(scene: Scene, graph: ImageGraph, truth: Tensor) -> float:
    """The fraction of known moves that lead to a node of another state than in the room."""
    known = [(node, action, end) for node, moves in enumerate(graph.moves) for action, end in enumerate(moves)]
    known = [(node, action, end) for node, action, end in known if end != UNKNOWN]
    wrong = [truth[end] != step(scene.graph, int(truth[node]), action) for node, action, end in known]
    return float(np.mean(wrong))


def episode(
    place: Place, guide: Guide, truth: Tensor, start: int, generator: np.random.Generator
) -> tuple[int, int, int]:
    """Go until the map says that this is the goal.

    Returns:
        The last state, the number of steps, and how often the agent was where the map said.
    """
    state, located = start, 0
    for steps in range(MAX_STEPS + 1):
        action = guide.advise(place.look(state))
        node = guide.graph.at
        located += node is not None and int(truth[node]) == state
        if node in guide.goals or steps == MAX_STEPS:
            break
        guide.action = int(generator.integers(4)) if action is None else action
        state = step(place.scene.graph, state, guide.action)
    return state, steps, located


def measured(place: Place, threshold: float, *, verify: bool) -> dict[str, float]:
    """`MEASURES` in one room: one walk, and then its episodes with the same map."""
    graph, scene = Traced(threshold, verify=verify), place.scene
    generator = np.random.default_rng(0)
    graph.state = int(generator.integers(len(scene)))
    truth = mapped(place, graph)
    found: dict[str, list[float]] = {"SR": [], "SPL": [], "located": []}
    wrong = wrong_links(scene, graph, truth)
    around = looks(scene, place.clean)
    for goal, start in place.pairs:
        guide = Guide(graph, around(goal), 0)
        end, steps, located = episode(place, guide, truth, start, generator)
        shortest = int(scene.distances[start, goal])
        found["SR"].append(end == goal)
        found["SPL"].append((end == goal) * shortest / max(steps, shortest))
        found["located"].append(located / (steps + 1))
    means = {name: float(np.mean(values)) for name, values in found.items()}
    return {**means, "wrong links": wrong, "nodes a state": len(graph) / len(scene)}


def measure(options: argparse.Namespace) -> str:
    """Measure, and write a report; the text of its README."""
    scenes = list(read_collection(options.collection).select(split="validation")[: options.rooms])
    world = drawn_goals(scenes, options.goals)
    encoder = load_encoder(options.encoder, precision="bfloat16")
    found: Measured = {}
    for kind, strength, places in conditions(world, encoder, options.kinds):
        for threshold, verify in VARIANTS:
            rooms = [measured(place, threshold, verify=verify) for place in places]
            means = {name: float(np.mean([room[name] for room in rooms])) for name in MEASURES}
            found[kind, strength, threshold, verify] = means
            print(kind, strength, threshold, verify, *(f"{value:.3f}" for value in means.values()), flush=True)
    return report(found, world, options.out)


def report(found: Measured, world: World, out: Path) -> str:
    """Write tables and figure; the text of the README."""
    out.mkdir(parents=True, exist_ok=True)
    _draw(found, out)
    text = (
        f"Rooms of the validation split: {len(world.scenes)}, with {len(world)} states. Each is walked through once, "
        f"{WALK} steps for each state at most; then {len(world.goals)} goals, {STARTS} episodes of each room and "
        f"distance, at most {MAX_STEPS} steps. The strengths are the largest of each view. Mean over rooms. *Located*: "
        "fraction of steps in which the agent is where the map says. *Wrong links*: fraction of the map's moves that "
        f"lead elsewhere than in the room. First table: threshold {SHOWN:g}. Second: SR and SPL by threshold. +: a "
        "match needs a neighbour that matches too; -: without."
    )
    shown = "SR over the strength of each disturbance, by threshold, with the check of matches and without"
    return write_tables(out, "What false loop closures cost", text, _tables(found), {"wrong_merges": shown})


def _tables(found: Measured) -> dict[str, Table]:
    """All measures at one threshold, and SR and SPL at each."""
    heads = (Column("disturbance"), Column("strength", "g"))
    signs = (False, True)
    table = Table(*heads, *(Column(f"{name} {'-+'[sign]}", ".3f") for name in MEASURES for sign in signs))
    by_threshold = Table(
        *heads,
        *(Column(f"{name} {limit:g}{'-+'[verify]}", ".3f") for name in MEASURES[:2] for limit, verify in VARIANTS),
    )
    for key in dict.fromkeys(key[:2] for key in found):
        table.add(*key, *(found[(*key, SHOWN, sign)][name] for name in MEASURES for sign in signs))
        by_threshold.add(*key, *(found[(*key, *variant)][name] for name in MEASURES[:2] for variant in VARIANTS))
    return {"wrong_merges": table, "wrong_merges_by_threshold": by_threshold}


def _draw(found: Measured, out: Path) -> None:
    """SR over the strength of each disturbance, a line for each variant."""
    kinds = [kind for kind in dict.fromkeys(key[0] for key in found) if kind != "none"]
    figure = Figure(figsize=(11, 3), layout="constrained")
    for axes, kind in zip(figure.subplots(1, len(kinds), sharey=True, squeeze=False)[0], kinds, strict=True):
        strengths = sorted({key[1] for key in found if key[0] == kind})
        keys = [("none", 0.0), *((kind, strength) for strength in strengths)]
        for (threshold, verify), color in zip(VARIANTS, COLORS, strict=False):
            rates = [found[(*key, threshold, verify)]["SR"] for key in keys]
            label = f"{threshold:g}{'' if verify else ', not verified'}" if kind == kinds[0] else None
            axes.plot(range(len(keys)), rates, "o-" if verify else "o--", color=color, markersize=3.5, label=label)
        axes.set_xticks(range(len(keys)), [f"{key[1]:g}" for key in keys])
        unit = "fraction of places" if kind == "twins" else DISTURBANCES[kind][0]
        axes.set(title=kind, xlabel=unit, ylim=(-0.03, 1.03), ylabel="SR" if kind == kinds[0] else None)
        plain(axes)
    figure.legend(loc="outside lower center", ncols=len(VARIANTS), frameon=False, title="threshold")
    save_figure(figure, out, "wrong_merges")


def main() -> None:
    """The program."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("collection", type=Path, help="a folder made by scenes.py sample")
    parser.add_argument("--out", type=Path, default=Path("reports/wrong_merges"))
    parser.add_argument("--rooms", type=positive, help="the first so many of the validation split; all if left out")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS, help="what is done to the views")
    parser.add_argument("--goals", type=positive, default=10, help="of each room")
    parser.add_argument("--encoder", default="resnet50_small", help="of the collection's features")
    with one_line_exits(), one_line_errors():
        print(measure(parser.parse_args()))


if __name__ == "__main__":
    main()
