"""Maps of a world that changes: one walk through each scene, and how right what it found is."""

from typing import NamedTuple

import torch
from torch import Tensor

from dirl.agent.mapping.graph_policy import explore
from dirl.agent.mapping.places import ParticleMapper, PlaceMap
from dirl.evaluation.episodes import drawn_looks
from dirl.models import LocalisingMemory
from dirl.perception.recognition.recogniser import VisitScores
from dirl.scenes.graph import AHEAD, BACK, RIGHT
from dirl.scenes.world import World


class Quality(NamedTuple):
    """How a map compares with the scene that was walked through."""

    nodes: float
    """Nodes for each state that the walker saw; above 1 where it did not recognise a place."""
    covered: float
    """Share of the scene's states that it saw."""
    wrong: float
    """Share of the map's moves that lead elsewhere than in the scene."""


def map_scene(
    world: World,
    index: int,
    memory: LocalisingMemory,
    scores: VisitScores,
    steps_per_state: float,
    *,
    panorama: bool = False,
) -> tuple[PlaceMap, list[int]]:
    """Map a scene by one walk from a random state; return the map and the states passed, by their places in the scene.

    It has at most ``steps_per_state`` steps for each state. Every visit has a look sampled for it; the scores are log
    odds that two visits are of the same place. The walker sees four views, or in a ``panorama`` those of all headings,
    and the arrows of a tour.
    """
    possible = world.possible

    def arrows(visit: Tensor) -> Tensor:
        return possible[visit % len(world)]

    turns = int(world.turns[index])
    mapper = ParticleMapper(memory, scores.of_visits, turns=turns, arrows=arrows if panorama else None)
    around = world.panoramas() if panorama else world.surrounding
    scene, offset = world.scenes[index], world.offsets[index]
    generator = torch.Generator(world.device).manual_seed(0)

    def seen(state: int) -> Tensor:
        here = torch.tensor([offset + state], device=world.device)
        ahead = drawn_looks(here, len(world), world, generator)
        return around[offset + state] + (ahead - ahead % len(world))

    start = int(torch.randint(len(scene), (1,), generator=generator, device=world.device))
    passed = explore(mapper, scene.graph, start, round(steps_per_state * len(scene)), seen)
    return mapper.map(), passed


def map_quality(known: PlaceMap, passed: list[int], world: World, index: int) -> Quality:
    """Compare a map, and the states of its visits, with the scene; see `map_scene`.

    A node is of the state where the walker first was at its place.
    """
    scene, places = world.scenes[index], known.places
    graph, turns, node = torch.tensor(scene.graph), known.turns, places.node[0]
    state = torch.full((len(known),), -1)
    for visit in reversed(range(len(passed))):
        facing = passed[visit]
        for heading in range(turns):
            state[node[visit] // turns * turns + (node[visit] + heading) % turns] = facing
            facing = int(graph[facing, RIGHT])
    truth = torch.where(graph < 0, torch.arange(len(graph))[:, None], graph)
    after, moves = places.after[0], torch.tensor([AHEAD, BACK])
    tried = after[:, moves] >= 0
    wrong = tried & (state[after[:, moves]] != truth[state][:, moves])
    seen = len(state.unique())
    return Quality(len(known) / seen, seen / len(scene), float(wrong.sum() / tried.sum().clamp(min=1)))
