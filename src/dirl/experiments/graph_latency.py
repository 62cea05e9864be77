"""What takes how long in a step of a navigator that is led by a map: processor time on one thread.

    python -m dirl.experiments.graph_latency my_rooms

The argument is a collection of rooms (``scenes.py sample``) with features of the included encoder; the smallest and the
largest room of its validation split are walked through with the shipped agent.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from dirl.agent.mapping import ImageGraph
from dirl.agent.mapping.walks import explore
from dirl.agent.navigator import Navigator
from dirl.cli.command_line import one_line_errors
from dirl.experiments.results import Column, Table
from dirl.runs.exits import one_line_exits
from dirl.scenes import Scene
from dirl.scenes.collection import read_collection

STEPS = 20


def median_ms(work: Callable[[int], Any]) -> float:
    """The median processor time of a piece of work, done `STEPS` times, milliseconds."""
    taken = []
    for step in range(STEPS):
        start = time.process_time()
        work(step)
        taken.append(1000 * (time.process_time() - start))
    return float(np.median(taken))


def latencies(scene: Scene) -> tuple[int, list[float]]:
    """Nodes of the map, and milliseconds of encoding, localising, planning, the policy, and a whole step."""
    assert scene.views is not None
    navigator = Navigator.load("general", "resnet50_small")
    graph = ImageGraph(navigator.threshold)
    explore(scene, graph, 0, 2 * len(scene))
    graph.lose()
    states = np.random.default_rng(0).integers(len(scene), size=STEPS)
    looks = [np.stack([scene.views[view] for view in scene.surrounding[state]]) for state in states]
    features = torch.tensor(scene.features).float()[torch.tensor(scene.surrounding)[states]]
    encode = median_ms(lambda step: navigator._encode(looks[step], "images"))
    localise = median_ms(lambda step: graph.follow(features[step]))
    plan = median_ms(lambda step: graph.plan([step]))
    navigator.reset(looks[0], graph=graph)
    whole = median_ms(lambda step: navigator.act(looks[step]))
    navigator.reset(looks[0])
    known = navigator._encode(looks[0], "images")[0][0]
    navigator.encoder = lambda images: known
    policy = median_ms(lambda step: navigator.act(looks[step]))
    return len(graph), [encode, localise, plan, policy, whole]


def measure(collection: Path) -> str:
    """The table of the smallest and the largest room."""
    torch.set_num_threads(1)
    rooms = read_collection(collection).select(split="validation")
    sizes = [entry.states for entry in rooms.entries]
    table = Table(
        Column("nodes", "d"),
        *(Column(f"{name}, ms", ".1f") for name in ("encode", "localise", "plan", "policy", "step")),
    )
    for index in (int(np.argmin(sizes)), int(np.argmax(sizes))):
        nodes, found = latencies(rooms[index])
        table.add(nodes, *found)
    return table.markdown()


def main() -> None:
    """The program."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("collection", type=Path, help="a folder made by scenes.py sample")
    with one_line_exits(), one_line_errors():
        print(measure(parser.parse_args().collection))


if __name__ == "__main__":
    main()
