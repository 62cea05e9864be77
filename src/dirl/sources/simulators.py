"""Scenes from simulators: the places that an agent can walk to, found by trying every move, and their views."""

from collections import deque

import numpy as np
from tqdm import tqdm, trange

from dirl.scenes.graph import AHEAD, BACK, shortest_distances, turns_only
from dirl.scenes.live import Pose, Simulator, looked, simulator_errors, state_pose, stride, turns_by_angle
from dirl.scenes.scene import Scene, SceneError
from dirl.scenes.views import encode

Cell = tuple[int, int]
"""A place, in steps from the first one."""


def take_scene(
    simulator: Simulator, *, source: str, step: float, turn: float, most: int | None = None
) -> tuple[Scene, list[bytes]]:
    """Return a scene of the places that can be walked to and fro from the simulator's agent, and its views, WebP.

    Places are on a grid. A move leads to a neighbouring place, by 90-degree headings along the axes and by the diagonal
    ones askew; along other headings, such as those of 30 degrees, moves are blocked, as in the rooms of dirl.

    Args:
        simulator: with the agent in the scene.
        source: of the scene, such as ``vizdoom``.
        step: metres between places.
        turn: degrees; goes into 90 without rest.
        most: places at most, the nearest to the start; all if left out.

    Raises:
        SceneError: a turn that does not go into 90 degrees, no place to go, or a failure of the simulator.
    """
    turns = turns_by_angle(turn)
    with simulator_errors(simulator.name):
        x, z, _ = simulator.pose
        ways = _explore(simulator, (x, z), step, range(0, 360, 45 if turns % 8 == 0 else 90), most)
    number = {cell: place for place, cell in enumerate(ways)}
    headings = np.arange(turns) * 360 / turns
    graph = turns_only(len(number), turns)
    for cell, place in number.items():
        first = turns * place
        for k, heading in enumerate(headings.tolist()):
            for action, way in ((AHEAD, heading), (BACK, (heading + 180) % 360)):
                end = number.get(ways[cell].get(way, cell), place)
                if end != place:
                    graph[first + k, action] = turns * end + k
    cells = list(number)
    back = np.flatnonzero(shortest_distances(graph, np.arange(turns))[::turns, 0] >= 0)
    kept = (turns * back[:, None] + np.arange(turns)).ravel()
    if len(back) < 2:
        raise SceneError(f"{simulator.name}: no move of {step:g} m leads anywhere and back; try a shorter step=")
    renumbered = np.full(len(graph) + 1, -1)
    renumbered[kept] = np.arange(len(kept))
    places = [(x + step * cells[place][0], z + step * cells[place][1]) for place in back]
    scene = Scene(
        name=simulator.name,
        graph=renumbered[graph[kept]],
        positions=np.repeat(places, turns, axis=0),
        headings=np.tile(headings, len(places)),
        source=source,
        extractor="none",
        origin=simulator.name,
    )
    views = []
    with simulator_errors(simulator.name):
        for state in trange(len(scene), desc="views", disable=None):
            pose = state_pose(scene, state)
            simulator.place(pose)
            views.append(encode(looked(simulator, pose.heading)))
    return scene, views


def _explore(
    simulator: Simulator, start: tuple[float, float], step: float, headings: range, most: int | None
) -> dict[Cell, dict[float, Cell]]:
    """Return every place, in order of discovery, with the places that each free heading leads to."""
    ways: dict[Cell, dict[float, Cell]] = {(0, 0): {}}
    todo = deque(ways)
    with tqdm(desc="places", unit="", disable=None) as bar:
        while todo:
            cell = todo.popleft()
            bar.update()
            for heading in headings:
                simulator.place(Pose(start[0] + step * cell[0], start[1] + step * cell[1], heading))
                if not simulator.push(stride(heading, step)):
                    continue
                radians = np.radians(heading)
                end = (cell[0] + round(1.2 * np.sin(radians)), cell[1] + round(1.2 * np.cos(radians)))
                if end not in ways and (most is None or len(ways) < most):
                    ways[end] = {}
                    todo.append(end)
                ways[cell][heading] = end
    return ways
