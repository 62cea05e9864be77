"""A policy's episodes as a web page: one self-contained HTML file for each scene, see docs/howto/viewer.md."""

import base64
import json
from collections.abc import Sequence
from importlib.resources import files
from typing import Any
from urllib.parse import quote

import numpy as np
import torch
from torch import Tensor, nn

from dirl.agent.decisions import answers
from dirl.agent.mapping import ImageGraph
from dirl.envs import SurroundingViews
from dirl.models import EpisodicMemory, PlanningMemory, recurrent_keys
from dirl.recognition.matching import Arrived, TemplateStop
from dirl.recognition.recogniser import NCC
from dirl.recognition.tables import described_visits
from dirl.scenes import ACTIONS, Scene, World
from dirl.scenes.geometry import heading_directions, step_length
from dirl.scenes.graph import AHEAD, BACK, LEFT, RIGHT, turns_per_circle
from dirl.scenes.views import encode


def viewer_pages(
    policy: nn.Module,
    world: World,
    observation: SurroundingViews,
    *,
    matching: TemplateStop,
    stop: Tensor | Arrived | None,
    max_steps: int,
    title: str,
    memory: EpisodicMemory | PlanningMemory | None = None,
    graphs: Sequence[ImageGraph] | None = None,
    last_steps: int = 0,
) -> dict[str, str]:
    """Pages to step through greedy episodes and to walk the scenes by keyboard.

    A scene is a finite graph, so a page holds the output of the policy for each pair of goal and state, and plays any
    episode as `dirl.evaluation.protocol.run_episodes` would.

    Args:
        policy: with its present weights.
        world: the scenes and goals to choose from.
        observation: what the policy observes.
        matching: computes the matching scores, and has the threshold.
        stop: where an agent stops on its way to each goal, bool ``[P]``; at the goal itself if None.
        max_steps: after so many steps an episode has failed.
        title: names the run; the same for all scenes.
        memory: changes logits by what was done in the episode.
        graphs: a topological map of each scene, which leads the agent; to be drawn beside the map.
        last_steps: so near the goal the policy decides by itself.

    Returns:
        The HTML text of each scene's page by its file name, ``viewer_<scene>.html``. The pages link to each other, and
        belong in one folder.

    Raises:
        ValueError: the policy depends on more than the state, or the world changes, so that a state has no single
            output.
    """
    if world.looks > 1 or callable(stop):
        raise ValueError(
            f"the viewer shows one look of each state, and {world.names[0]} has {world.looks}: leave out viewer=true"
        )
    if observation.history or recurrent_keys(policy):
        raise ValueError(
            "the viewer needs a policy that depends on the present state only; with observation=sequential or a memory "
            "it depends on earlier states too: leave out viewer=true"
        )
    logits, values = answers(policy, world, observation)
    scores = matching.scores(world)
    common = {
        "title": title,
        "actions": ACTIONS,
        "max_steps": max_steps,
        "stops_by": "goal" if stop is None else "match",
        "threshold": matching.threshold,
        "match": matching.match,
        "goal_view": observation.goal_view,
        "last_steps": last_steps,
        "scenes": [{"name": name, "file": file_name(name)} for name in world.names],
    }
    pages = {}
    for index, (scene, offset) in enumerate(zip(world.scenes, world.offsets, strict=True)):
        goals = []
        for row in world.goals_in(index):
            goal = int(world.goals[row]) - offset
            goals.append(
                {
                    "state": goal,
                    "logits": _base64(world.block(logits, row)),
                    "values": _base64(world.block(values, row)),
                    "scores": _base64(world.block(scores, row)),
                    "distances": world.block(world.distances, row).tolist(),
                    "stops": [goal] if stop is None else torch.nonzero(world.block(stop, row)).flatten().tolist(),
                }
            )
        recall = None if memory is None else _memory(memory, world, index)
        seen = world.features[offset : offset + len(scene)].cpu()
        image_graph = None if graphs is None else _image_graph(graphs[index], scene, seen)
        data = {**common, **_room(scene), "memory": recall, "image_graph": image_graph, "goals": goals}
        pages[file_name(scene.name)] = _page(data)
    return pages


def file_name(scene: str) -> str:
    """The file name of a scene's page; the scene's name may contain characters that a file name cannot."""
    return f"viewer_{quote(scene, safe=' ')}.html"


def _room(scene: Scene) -> dict[str, Any]:
    """The data of a scene that a page needs, apart from its goals."""
    return {
        "scene": scene.name,
        "graph": scene.graph.tolist(),
        "surrounding": scene.surrounding.tolist(),
        "turns": turns_per_circle(scene.graph),
        "positions": scene.positions.round(4).tolist(),
        "directions": heading_directions(scene).round(4).tolist(),
        "side": round(step_length(scene), 4),
        "source": scene.source,
        "views": None if scene.views is None else [_view(scene, state) for state in range(len(scene))],
    }


def _memory(memory: EpisodicMemory | PlanningMemory, world: World, index: int) -> dict[str, Any]:
    """The data of an episodic memory that a page needs: options, and the states that look like each state."""
    visits = described_visits(NCC(), world, index)
    same = NCC().scores(visits, visits) > memory.threshold
    names = ("repeated", "turn") if isinstance(memory, PlanningMemory) else ("penalty", "opposite", "blocked")
    options = {name: getattr(memory, name) for name in names}
    return {**options, "alike": [torch.nonzero(states).flatten().tolist() for states in same]}


def _image_graph(graph: ImageGraph, scene: Scene, features: Tensor) -> dict[str, Any]:
    """The data of a topological map that a page needs: the place that each state looks like most, and the moves."""
    node = graph.scores(features[torch.tensor(scene.surrounding)]).argmax(1)
    moves, first = np.array(graph.moves), np.arange(len(graph))
    for _ in range(graph.turns):
        for turn in (RIGHT, LEFT):
            first = np.minimum(first, first[np.where(moves[:, turn] >= 0, moves[:, turn], np.arange(len(graph)))])
    place = np.unique(first, return_inverse=True)[1]  # of each node
    pairs = {
        (int(place[start]), int(place[to[action]]))
        for start, to in enumerate(graph.moves)
        for action in (AHEAD, BACK)
        if to[action] >= 0
    }
    links = sorted({(min(pair), max(pair)) for pair in pairs if pair[0] != pair[1]})
    return {"place": place[node.numpy()].tolist(), "places": int(place.max()) + 1, "links": links}


def _view(scene: Scene, state: int) -> str:
    assert scene.views is not None
    return base64.b64encode(scene.views.encoded(state) or encode(scene.views[state])).decode()


def _base64(values: Tensor) -> str:
    """Numbers as little-endian float32, which JavaScript reads back without any rounding."""
    return base64.b64encode(values.cpu().numpy().astype("<f4").tobytes()).decode()


def _page(data: dict[str, Any]) -> str:
    """The template with style, script and data inside."""
    # A scene's name may contain any text, and must not end the script element.
    text = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
    folder = files("dirl.reporting")
    page, style, script = (
        folder.joinpath(f"viewer.{kind}").read_text(encoding="utf-8") for kind in ("html", "css", "js")
    )
    return page.replace("{{style}}", style).replace("{{script}}", script).replace("{{data}}", text)
