"""Walk once, then go to any photo: unseen rooms, with no map, a list of what was seen, and a topological map.

Every room of the test split of a collection is walked through once, from a random state, with so many steps for each
state; then episodes begin at sampled states.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import nn

from dirl.agent.mapping import GraphMemory, GuidedPolicy
from dirl.agent.mapping.policy import LAST_STEPS
from dirl.envs import SurroundingViews
from dirl.evaluation.episodes import Episodes
from dirl.evaluation.protocol import EvaluationProtocol
from dirl.experiments.figures import band, panels, save_figure
from dirl.experiments.measures import (
    FAR,
    MAX_STEPS,
    MEASURES,
    STARTS,
    by_measure,
    by_room,
    decimals,
    drawn_starts,
    load_agent,
    measure_table,
    within,
    wrong_goals,
)
from dirl.experiments.results import Table, write_tables
from dirl.perception.recognition.matching import FRONT_THRESHOLD, TemplateStop
from dirl.reporting.statistics import iqm
from dirl.runs.paths import RunError
from dirl.scenes import Scene, World, make_world
from dirl.scenes.collection import read_collection
from dirl.scenes.goals import well_reached
from dirl.scenes.palette import BLUE, GREEN, GREY, ORANGE, PURPLE

THRESHOLD = 0.95
"""Above which views match: of goals, where an agent stops, and of nodes."""

WALKS = (0.25, 0.5, 1.0, 2.0)
"""Steps of a walk for each state of the room."""

GOALS = 20
"""Of each room."""

PHOTO = ", one photo of the goal"

LIST, ALONE, RECALLING = "list, walk of 2 N steps", "policy without a map", "policy with episodic memory"

Policies = Mapping[str, tuple[nn.Module, Any]]
"""A policy and its episodic memory, by how goals are shown; empty if only maps are measured."""


def drawn_goals(scenes: Sequence[Scene], goals: int) -> World:
    """Scenes with some goals each, sampled among the states that all others reach."""
    chosen = {}
    for index, scene in enumerate(scenes):
        generator = torch.Generator().manual_seed(index)
        states = torch.from_numpy(well_reached(scene)).nonzero().flatten()
        chosen[scene.name] = states[torch.randperm(len(states), generator=generator)[:goals]].tolist()
    return make_world(scenes, chosen)


def by_graph(steps: float) -> str:
    """The name of what is led by the graph of a walk."""
    return f"graph, walk of {steps:g} N steps"


def walked(protocol: EvaluationProtocol, policies: Policies) -> Iterator[tuple[str, Episodes]]:
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
    for view, (policy, recall) in policies.items():
        conditions, name = (photo, PHOTO) if view == "front" else (protocol, "")
        recalling = replace(conditions, memory=recall)
        yield ALONE + name, conditions.run(policy)
        yield RECALLING + name, recalling.run(policy)
        led = f"graph, last {LAST_STEPS} steps by the policy with memory"
        yield led + name, recalling.run(GuidedPolicy(policy, memory, LAST_STEPS))


def report_image_graph(collection: str, rooms: int | None, agent: str | None, out: Path) -> str:
    """Measure in the first so many rooms, or all, of a collection's test split, and write tables and a figure.

    The agent is of ``system=any_goal``, trained in other rooms; without one only maps are measured.

    Raises:
        RunError: the agent sees another world than that of the collection.
    """
    world = drawn_goals(read_collection(collection).select(split="test")[:rooms], GOALS)
    goals = {name: tuple(world.local_goals(index).tolist()) for index, name in enumerate(world.names)}
    where = {"scene": f"collection:{collection}", "split": "test", "rooms": len(world.scenes), "goals": goals}
    policies = {}
    for view in ("surrounding", "front") if agent else ():
        assert agent is not None
        _, policy, protocol = load_agent(agent, where, view)
        if protocol.world.names != world.names:
            raise RunError(f"{agent}: its world is not that of {where['scene']}")
        policies[view] = policy, protocol.memory
    return measure(world, policies, f"{len(world.scenes)} rooms of the test split", out)


def measure(world: World, policies: Policies, about: str, out: Path, starts: int = STARTS) -> str:
    """Measure maps, and policies beside them, and write a report; the text of its README.

    ``about`` says what the world is; ``starts`` are those of each scene and distance.
    """
    sees, stop = SurroundingViews(world), TemplateStop(THRESHOLD)(world)
    protocol = EvaluationProtocol(world, sees, drawn_starts(world, starts), stop, MAX_STEPS)
    table = measure_table({"led by": "", "scenes": "d"})
    far = Table({"SR, led by": "", **decimals(FAR)})
    rates: dict[str, list[float]] = {}
    for way, episodes in walked(protocol, policies):
        values = by_measure(world, episodes)
        print(way, *(f"{key} {sum(values[key]) / len(values[key]):.4f}" for key in MEASURES), flush=True)
        table.add(way, len(world.scenes), *values.values())
        far.add(way, *(by_room(world, within(episodes, *limits), "sr") for limits in FAR.values()))
        rates[way] = values["sr"]
    text = (
        f"{about}, {len(world)} states, {len(protocol.starts[0])} episodes, at most {MAX_STEPS} steps, stop by "
        f"template matching above {THRESHOLD}, above which nodes match too. N is the number of states of a scene. "
        "Mean over scenes, its 95 % bootstrap interval, and the worst scene."
    )
    _draw(rates, out)
    tables = {"image_graph": table, "image_graph_by_start": far}
    shown = "SR over the length of the walk that makes the map, beside the policy alone and a random walk"
    return write_tables(out, "Walk once, then go to any photo", text, tables, {"image_graph": shown})


def _draw(rates: Mapping[str, list[float]], out: Path) -> None:
    """SR over the length of the walk, beside what needs none or profits from none."""
    figure, (axes,) = panels(1, (6, 3.4))
    rooms = torch.tensor([rates[by_graph(steps)] for steps in WALKS]).T
    band(axes, WALKS, rooms, BLUE, "graph", marker="o")
    for name, color in {ALONE: PURPLE, RECALLING: GREEN, LIST: ORANGE, "random walk": GREY}.items():
        if name in rates:
            axes.axhline(float(iqm(rates[name])), color=color, linestyle="--", label=name)
    axes.set(xlabel="steps of the walk for each state of the room", ylabel="SR", ylim=(-0.03, 1.03))
    figure.legend(loc="outside right center", frameon=False)
    save_figure(figure, out, "image_graph")
