"""A policy's episodes as a web page: one self-contained HTML file for each scene, see docs/howto/viewer.md."""

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.resources import files
from urllib.parse import quote

import numpy as np
import torch
from torch import Tensor, nn

from dirl.agent.decisions import answers
from dirl.agent.mapping import ImageGraph
from dirl.envs import SurroundingViews
from dirl.evaluation.episodes import every_start
from dirl.evaluation.experts import ShortestPathPolicy
from dirl.evaluation.protocol import EvaluationProtocol
from dirl.models import LocalisingMemory, recurrent_keys
from dirl.perception.recognition.recogniser import TemplateStop, described_visits
from dirl.scenes import ACTIONS, Scene
from dirl.scenes.graph import AHEAD, BACK, LEFT, RIGHT
from dirl.scenes.views import encoded_view
from dirl.scenes.world import World

MOST_WALKS = 100_000
"""Episodes of an agent with a memory that are computed for the pages; of more goals, some are left out."""


def viewer_pages(
    policy: nn.Module,
    protocol: EvaluationProtocol,
    *,
    matching: TemplateStop,
    title: str,
    critic: bool = True,
    beside: Mapping[str, tuple[nn.Module, EvaluationProtocol]] | None = None,
    graphs: Sequence[ImageGraph] | None = None,
    last_steps: int = 0,
) -> dict[str, str]:
    """Return pages to step through greedy episodes and to walk the scenes by keyboard.

    A scene is a finite graph: a page holds the output of the policy for each pair of goal and state, and the episode
    that begins there. What agents do is computed here; the page plays it.

    Args:
        policy: with its present weights.
        protocol: where and how it is evaluated; starts are not used.
        matching: computes the matching scores, and has the threshold.
        title: names the run; the same for all scenes.
        critic: whether the policy's state values were trained; else they are not shown.
        beside: other agents by name, in a world of the same scenes and goals, to be walked at the same time.
        graphs: a topological map of each scene, which leads the agent; to be drawn beside the map.
        last_steps: so near the goal the policy decides by itself.

    Returns:
        The HTML text of each scene's page by its file name, ``viewer_<scene>.html``. The pages link to each other, and
        belong in one folder.

    Raises:
        ValueError: the policy depends on more than the state, or the world changes, so that a state has no single
            output; or an agent beside it is of another world.
    """
    world, observation = protocol.world, protocol.observation
    if world.looks > 1 or callable(protocol.stop):
        raise ValueError(
            f"the viewer shows one look of each state, and {world.names[0]} has {world.looks}: leave out viewer=true"
        )
    if observation.history or recurrent_keys(policy):
        raise ValueError(
            "the viewer needs a policy that depends on the present state only; with observation=sequential or a memory "
            "it depends on earlier states too: leave out viewer=true"
        )
    for name, (_, other) in (beside or {}).items():
        if not (torch.equal(other.world.goals, world.goals) and torch.equal(other.world.graph, world.graph)):
            raise ValueError(f"beside={name}: is evaluated in other scenes or for other goals")
    agents = _agents(policy, protocol, beside or {})
    goal_index, start = every_start(world)
    every = 1 if protocol.memory is None else -(-len(start) // MOST_WALKS)
    starts = goal_index[goal_index % every == 0], start[goal_index % every == 0]
    walks = [_walks(*agent, starts) for agent in agents.values()]
    logits, values = answers(policy, world, observation)
    scores = matching.scores(world)
    common = {
        "facts": _facts(title, protocol, graphs is not None, last_steps),
        "actions": ACTIONS,
        "looks": SurroundingViews.order,
        "agents": list(agents),
        "max_steps": protocol.max_steps,
        "stops_by": "goal" if protocol.stop is None else "match",
        "threshold": matching.threshold,
        "match": matching.match,
        "goal_view": observation.goal_view,
        "scenes": [{"name": name, "file": file_name(name)} for name in world.names],
    }
    pages = {}
    for index, (scene, offset) in enumerate(zip(world.scenes, world.offsets, strict=True)):
        goals = []
        for row in [row for row in world.goals_of[index] if row in walks[0]]:
            goal = int(world.goals[row]) - offset
            stops = torch.arange(len(scene)) == goal if protocol.stop is None else world.block(protocol.stop, row)
            goals.append(
                {
                    "state": goal,
                    "logits": _base64(world.block(logits, row)),
                    "values": _base64(world.block(values, row)) if critic else None,
                    "scores": _base64(world.block(scores, row)),
                    "distances": world.block(world.distances, row).tolist(),
                    "stops": torch.nonzero(stops).flatten().tolist(),
                    "walks": [[of_agent[row].get(offset + state) for state in range(len(scene))] for of_agent in walks],
                }
            )
        image_graph = None if graphs is None else _image_graph(graphs[index], world, index)
        pages[file_name(scene.name)] = page({**common, **_room(scene), "image_graph": image_graph, "goals": goals})
    return pages


def _agents(
    policy: nn.Module, protocol: EvaluationProtocol, beside: Mapping[str, tuple[nn.Module, EvaluationProtocol]]
) -> dict[str, tuple[nn.Module, EvaluationProtocol]]:
    """Return the agents that a page can show, by name: the policy first."""
    plain = replace(protocol, memory=None)
    if isinstance(protocol.memory, LocalisingMemory):
        raise ValueError("the page cannot localise; leave viewer out, or add episodic_memory=planning")
    own = {"the policy": (policy, plain)}
    if protocol.memory is not None:
        own = {"the agent": (policy, protocol), "without memory": (policy, plain)}
    return {**own, **beside, "shortest path": (ShortestPathPolicy(protocol.world), replace(plain, stop=None))}


def _walks(policy: nn.Module, protocol: EvaluationProtocol, starts: tuple[Tensor, Tensor]) -> dict[int, dict[int, str]]:
    """Return the actions of each episode as digits, by the place of its goal in the world and its start."""
    by_goal: dict[int, dict[int, str]] = {}
    for goal, start, actions in zip(*(part.tolist() for part in starts), protocol.walks(policy, starts), strict=True):
        by_goal.setdefault(goal, {})[start] = "".join(map(str, actions.tolist()))
    return by_goal


def _facts(title: str, protocol: EvaluationProtocol, led: bool, last_steps: int) -> str:
    """Return what a page says of its agent."""
    leader = "Greedy policy"
    if led:
        steps = f"the last {last_steps} step{'' if last_steps == 1 else 's'}, and where the map knows no path"
        rest = f"; the greedy policy decides {steps}"
        leader = "Led by the topological map of one walk"
        leader += rest if last_steps else " to the goal; the greedy policy decides only where it knows no path"
    stop = "stopped by the environment, exactly at the goal" if protocol.stop is None else "template matching"
    memory = ""
    if protocol.memory is not None:
        memory = " Episodic memory: a plan to the best exit that was not tried in this episode."
    return f"{title}. {leader}; stopped by {stop}.{memory}"


def file_name(scene: str) -> str:
    """Return the file name of a scene's page; the scene's name may contain characters that a file name cannot."""
    return f"viewer_{quote(scene, safe=' ')}.html"


def _room(scene: Scene) -> dict[str, object]:
    """Return the data of a scene that a page needs, apart from its goals."""
    views = scene.views
    encoded = () if views is None else (encoded_view(views, state, 85) for state in range(len(scene)))
    return {
        "scene": scene.name,
        "graph": scene.graph.tolist(),
        "surrounding": scene.surrounding.tolist(),
        "positions": scene.positions.round(4).tolist(),
        "directions": scene.directions.round(4).tolist(),
        "side": round(scene.step_length, 4),
        "source": scene.source,
        "views": None if views is None else [base64.b64encode(view).decode() for view in encoded],
    }


def _image_graph(graph: ImageGraph, world: World, index: int) -> dict[str, object]:
    """Return what a page needs of a topological map: the place that each state looks like most, and the moves."""
    visits = described_visits(graph.recogniser, world, index)[: len(world.scenes[index])]
    node = graph.scores(visits).argmax(1)
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


def _base64(values: Tensor) -> str:
    """Return numbers as little-endian float32, which JavaScript reads back without any rounding."""
    return base64.b64encode(values.cpu().numpy().astype("<f4").tobytes()).decode()


def page(data: Mapping[str, object]) -> str:
    """Return the template with style, scripts and data inside."""
    # A scene's name may contain any text, and must not end the script element.
    text = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
    folder = files("dirl.reporting")
    template, style, script, drawing = (
        folder.joinpath(f"viewer{part}").read_text(encoding="utf-8") for part in (".html", ".css", ".js", "_map.js")
    )
    html = template.replace("{{style}}", style).replace("{{script}}", drawing + script)
    return html.replace("{{data}}", text)
