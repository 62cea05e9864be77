"""Walk once, then go to any photo: unseen rooms, with no map, a list of what was seen, and a topological map.

    python -m dirl.experiments.image_graph general --collection my_rooms --out reports/image_graph

The argument is a run of ``system=any_goal`` that was trained in other rooms; without it only maps are measured. Every
room of the test split of a collection (``scenes.py sample``) is walked through once, from a random state, with so many
steps for each state; then episodes begin at sampled states.
"""

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from matplotlib.figure import Figure
from torch import nn

from dirl.agent.mapping import GraphMemory, GuidedPolicy
from dirl.agent.mapping.policy import LAST_STEPS
from dirl.cli.command_line import one_line_errors
from dirl.config.choices import goal_view_options
from dirl.envs import SurroundingViews
from dirl.evaluation.episodes import Episodes
from dirl.evaluation.protocol import EvaluationProtocol
from dirl.experiments.any_goal import FAR, FAR_NAMES, MEASURES, within, wrong_goals
from dirl.experiments.results import Column, Table, save_figure, write_tables
from dirl.experiments.unseen_rooms import MAX_STEPS, by_room, drawn_starts
from dirl.recognition.matching import FRONT_THRESHOLD, TemplateStop
from dirl.reporting.statistics import bootstrap_interval, iqm
from dirl.reporting.style import plain
from dirl.runs.checkpoints import load_checkpoint
from dirl.runs.checks import RunError
from dirl.runs.exits import one_line_exits
from dirl.scenes import Scene, World, make_world
from dirl.scenes.collection import read_collection
from dirl.scenes.goals import well_reached
from dirl.scenes.palette import BLUE, GREEN, GREY, ORANGE, PURPLE
from dirl.training.load import load_trained

THRESHOLD = 0.95
"""Above which views match: of goals, where an agent stops, and of nodes."""

WALKS = (0.25, 0.5, 1.0, 2.0)
"""Steps of a walk for each state of the room."""

PHOTO = ", one photo of the goal"

LIST, ALONE, RECALLING = "list, walk of 2 N steps", "policy without a map", "policy with episodic memory"


def drawn_goals(scenes: Sequence[Scene], goals: int) -> World:
    """Scenes with some goals each, sampled among the states that all others reach."""
    scenes = list(scenes)
    chosen: dict[str, tuple[int, ...]] = {}
    for index, scene in enumerate(scenes):
        generator = torch.Generator().manual_seed(index)
        states = torch.from_numpy(well_reached(scene)).nonzero().flatten()
        chosen[scene.name] = tuple(states[torch.randperm(len(states), generator=generator)[:goals]].tolist())
    return make_world(scenes, chosen)


def by_graph(steps: float) -> str:
    """The name of what is led by the graph of a walk."""
    return f"graph, walk of {steps:g} N steps"


Trained = Mapping[str, tuple[nn.Module, Any]]
"""A policy and its episodic memory, by how goals are shown; empty if only maps are measured."""


def led_by_both(last_steps: int) -> str:
    """The name of what is led by a graph, and by the policy at the end."""
    if last_steps == 0:
        return "graph to the goal, policy only where it knows no way"
    return f"graph, last {last_steps} step{'s' * (last_steps > 1)} by the policy with memory"


def walked(
    protocol: EvaluationProtocol, trained: Trained, last_steps: Sequence[int] = (LAST_STEPS,)
) -> Iterator[tuple[str, Episodes]]:
    """Episodes from the same starts by what leads the agent."""
    world = protocol.world
    ahead = TemplateStop(FRONT_THRESHOLD, "front")(world)
    photo = replace(protocol, observation=SurroundingViews(world, "front"), stop=ahead)
    yield "random walk", protocol.run_random()
    yield LIST, protocol.run(GraphMemory(world, max(WALKS), THRESHOLD, merge=False))
    for steps in WALKS:
        memory = GraphMemory(world, steps, THRESHOLD)
        yield by_graph(steps), protocol.run(memory)
    yield by_graph(steps) + PHOTO, photo.run(memory)
    yield "graph, shown another goal", replace(protocol, shown=wrong_goals(world)).run(memory)
    for view, (policy, recall) in trained.items():
        conditions, name = (photo, PHOTO) if view == "front" else (protocol, "")
        recalling = replace(conditions, memory=recall)
        yield ALONE + name, conditions.run(policy)
        yield RECALLING + name, recalling.run(policy)
        for last in last_steps:
            yield led_by_both(last) + name, recalling.run(GuidedPolicy(policy, memory, last))


def _policy(run: Path, world: World, where: Mapping[str, Any], view: str) -> tuple[nn.Module, Any]:
    """The policy of a run on the features of another world, and its episodic memory."""
    names = {name: tuple(world.local_goals(index).tolist()) for index, name in enumerate(world.names)}
    trained = load_trained(load_checkpoint(run), str(run), {**where, "goals": names, **goal_view_options(view)})
    if trained.protocol.world.names != world.names:
        raise RunError(f"{run}: its world is not that of {where['scene']}")
    return trained.policy, trained.protocol.memory


def of_collection(options: argparse.Namespace) -> tuple[World, dict[str, Any]]:
    """The rooms to walk in, and the options that name them."""
    world = drawn_goals(read_collection(options.collection).select(split="test")[: options.rooms], options.goals)
    where = {"scene": f"collection:{options.collection}", "split": "test", "rooms": len(world.scenes)}
    return world, where


def measure(
    world: World,
    where: Mapping[str, Any],
    about: str,
    options: argparse.Namespace,
    last_steps: Sequence[int] = (LAST_STEPS,),
) -> str:
    """Measure, and write a report; the text of its README.

    Args:
        world: where.
        where: the options of that world, by name.
        about: what the world is.
        options: ``run``, ``starts`` of each scene and distance, ``out``.
        last_steps: within so many steps of the goal the policy decides, see `GuidedPolicy`; each is measured.
    """
    views = () if options.run is None else ("surrounding", "front")
    trained = {view: _policy(options.run, world, where, view) for view in views}
    protocol = EvaluationProtocol(
        world,
        SurroundingViews(world),
        drawn_starts(world, options.starts),
        TemplateStop(THRESHOLD)(world),
        MAX_STEPS,
        0,
    )
    table = Table(Column("led by"), Column("scenes", "d"), *(Column(name, ".3f") for name in MEASURES.values()))
    far = Table(Column("SR, led by"), *(Column(name, ".3f") for name in FAR_NAMES))
    rates: dict[str, list[float]] = {}
    for way, episodes in walked(protocol, trained, last_steps):
        values = [by_room(world, episodes, key) for key in MEASURES]
        print(way, *(f"{key} {sum(of) / len(of):.4f}" for key, of in zip(MEASURES, values, strict=True)), flush=True)
        table.add(way, len(world.scenes), *values)
        far.add(way, *(by_room(world, within(episodes, *limits), "sr") for limits in FAR))
        rates[way] = values[0]
    text = (
        f"{about}, {len(world)} states, {len(protocol.starts[0])} episodes, at most {MAX_STEPS} steps, stop by "
        f"template matching above {THRESHOLD}, above which nodes match too. N is the number of states of a scene. "
        "Interquartile mean over scenes, and its 95 % bootstrap interval."
    )
    options.out.mkdir(parents=True, exist_ok=True)
    _draw(rates, options.out)
    tables = {"image_graph": table, "image_graph_by_start": far}
    shown = "SR over the length of the walk that makes the map, beside the policy alone and a random walk"
    return write_tables(options.out, "Walk once, then go to any photo", text, tables, {"image_graph": shown})


def _draw(rates: Mapping[str, list[float]], out: Path) -> None:
    """SR over the length of the walk, beside what needs none or profits from none."""
    figure = Figure(figsize=(6, 3.4), layout="constrained")
    axes = figure.subplots()
    found = [rates[by_graph(steps)] for steps in WALKS]
    low, high = zip(*(bootstrap_interval(values) for values in found), strict=True)
    axes.fill_between(WALKS, low, high, color=BLUE, alpha=0.2, linewidth=0)
    axes.plot(WALKS, [iqm(values) for values in found], "o-", color=BLUE, label="graph")
    for name, color in {ALONE: PURPLE, RECALLING: GREEN, LIST: ORANGE, "random walk": GREY}.items():
        if name in rates:
            axes.axhline(float(iqm(rates[name])), color=color, linestyle="--", label=name)
    axes.set(xlabel="steps of the walk for each state of the room", ylabel="SR", ylim=(-0.03, 1.03))
    figure.legend(loc="outside right center", frameon=False)
    plain(axes)
    save_figure(figure, out, "image_graph")


def positive(text: str) -> int:
    """A whole number above 0, of the command line."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text}: must be a whole number above 0")
    return int(text)


def program(description: str | None) -> argparse.ArgumentParser:
    """The options of a measurement."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, nargs="?", help="a run of system=any_goal, or the name of a shipped agent")
    parser.add_argument("--out", type=Path, default=Path("reports/image_graph"))
    parser.add_argument("--goals", type=positive, default=20, help="of each scene")
    parser.add_argument("--starts", type=positive, default=20, help="episodes of each scene and distance")
    return parser


def main() -> None:
    """The program."""
    parser = program(__doc__)
    parser.add_argument("--collection", type=Path, required=True, help="a folder made by scenes.py sample")
    parser.add_argument("--rooms", type=positive, help="the first so many of the test split; all if left out")
    options = parser.parse_args()
    with one_line_exits(), one_line_errors():
        world, where = of_collection(options)
        print(measure(world, where, f"{len(world.scenes)} rooms of the test split", options))


if __name__ == "__main__":
    main()
