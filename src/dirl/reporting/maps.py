"""Maps of a room with the policy, the state value and the matching coefficient of every state."""

import math
import textwrap
from pathlib import Path

import numpy as np
from matplotlib.collections import PatchCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Wedge
from numpy.typing import ArrayLike, NDArray
from scipy.special import softmax

from dirl.reporting.style import draw_room, marker, write_figure
from dirl.scenes import Scene
from dirl.scenes.graph import shortest_distances, turns_per_circle
from dirl.scenes.palette import COLORS, GOAL_COLOR, WALL_COLOR

ACTION_NAMES = ("ahead", "turn right", "turn left", "back")

LOST_COLOR, MATCH_COLOR = "#3A3A3A", "#00B7FF"
MAP_WIDTH, LEGEND_HEIGHT = 4.8, 0.5
"""Inches: of each map, and of the legend below them."""


def draw_policy(
    scene: Scene,
    goal: int,
    logits: ArrayLike,
    value: ArrayLike,
    matching: ArrayLike,
    file: Path,
    *,
    title: str,
    threshold: float = 0.9,
) -> None:
    """Draw three maps side by side, as a PNG: most probable action, state value, matching coefficient.

    Every place is split into one wedge for each heading, on the side that the heading faces.

    Args:
        scene: N states.
        goal: a state of the scene; the policy's, the value's and the matching's.
        logits: of the actions in each state, float ``[N, 4]`` in the order of `dirl.scenes.ACTIONS`.
        value: of each state, float ``[N]``.
        matching: of each state with the goal, float ``[N]``, see `dirl.perception.recognition.recogniser.TemplateStop`.
        file: the image to write.
        title: of the figure.
        threshold: states that match better than this are outlined: there the agent stops.

    Raises:
        ValueError: the goal is no state that can be reached.
    """
    scene.check_goals([goal])
    chances = softmax(np.asarray(logits, float), 1)
    values, scores = (np.asarray(each, float) for each in (value, matching))
    side, half = scene.step_length, 180 / turns_per_circle(scene.graph)
    directions = scene.directions
    wedges = [
        Wedge((x, z), 0.48 * side, angle - half, angle + half)
        for (x, z), angle in zip(scene.positions, np.degrees(np.arctan2(*directions.T[::-1])), strict=True)
    ]

    spans = np.ptp(scene.positions, axis=0) + 2 * side
    # Maps of tall, narrow rooms are drawn smaller, not taller than a page.
    width = min(MAP_WIDTH, 1.1 * MAP_WIDTH * spans[0] / spans[1])
    full_width = 3 * max(width, 3.2) + 1.6
    title = textwrap.fill(title, int(11 * full_width))
    height = width * spans[1] / spans[0] + 0.5 + LEGEND_HEIGHT + 0.25 * (title.count("\n") + 1)
    figure = Figure((full_width, height), layout="constrained")
    figure.suptitle(title)
    maps = policy_map, value_map, matching_map = figure.subplots(1, 3, sharex=True, sharey=True)
    titles = "most probable action", "state value", "matching with the goal's views"
    for axes, shown in zip(maps, titles, strict=True):
        draw_room(axes, scene, side)
        axes.set_anchor("C")  # as a colour bar sets it for the maps that have one
        axes.set_title(shown, fontsize=10)
        axes.label_outer()
        at = scene.positions[goal] + 0.31 * side * directions[goal]
        axes.plot(*at, "*", color=GOAL_COLOR, markeredgecolor="black", markersize=9, zorder=7)

    # The stronger the colour of an action, the surer the policy; evenly divided chances are white.
    actions = chances.argmax(1)
    sure = np.clip((chances.max(1) - 0.25) / 0.75, 0, 1)[:, None]
    faces = 1 - sure * (1 - np.array([to_rgb(color) for color in COLORS])[actions])
    lost = never_arrives(scene, goal, actions)
    faces[lost] = to_rgb(LOST_COLOR)
    faces[goal] = to_rgb(GOAL_COLOR)  # where no action is left
    policy_map.add_collection(PatchCollection(wedges, facecolors=faces, edgecolors="white", linewidths=0.5, zorder=2))

    lowest = min(scores.min(), threshold)
    for axes, numbers, limits, cmap in (
        (value_map, values, (values.min(), values.max()), "viridis"),
        (matching_map, scores, (lowest, 1), "magma"),
    ):
        heat = PatchCollection(wedges, cmap=cmap, edgecolors="face", linewidths=0.2, zorder=2)
        heat.set_array(numbers)
        heat.set_clim(*limits)
        axes.add_collection(heat)
        figure.colorbar(heat, ax=axes, shrink=0.8, aspect=30, pad=0.02)
    above = np.flatnonzero(scores > threshold)
    outlined = [wedges[state] for state in above]
    matching_map.add_collection(
        PatchCollection(outlined, facecolor="none", edgecolor=MATCH_COLOR, linewidth=1.6, zorder=5)
    )

    handles: list[Patch | Line2D] = [
        Patch(color=color, label=name) for color, name in zip(COLORS, ACTION_NAMES, strict=False)
    ]
    if lost.any():
        handles.append(Patch(color=LOST_COLOR, label=f"never arrives, states: {lost.sum()}"))
    label = f"matches above {threshold:g}, states: {len(above)}"
    handles.append(Patch(facecolor="none", edgecolor=MATCH_COLOR, linewidth=1.6, label=label))
    handles.append(Patch(color=WALL_COLOR, label="walls, furniture"))
    handles.append(marker("*", 11, GOAL_COLOR, "black", f"goal, state {goal}"))
    figure.legend(
        handles=handles,
        loc="outside lower center",
        ncols=8,
        frameon=False,
        fontsize=9,
        handlelength=1.4,
        columnspacing=1.6,
    )
    write_figure(figure, file, dpi=130)


def never_arrives(scene: Scene, goal: int, actions: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Return the states from which these actions, int64 ``[N]``, lead into a loop and never to the goal, bool ``[N]``.

    States from which no policy could reach the goal are excluded.
    """
    states = np.arange(len(scene))
    after = scene.graph[states, actions]
    after = np.where(after < 0, states, after)
    after[goal] = goal
    # Every pass doubles the steps that `after` looks ahead, in the end beyond the longest path.
    for _ in range(math.ceil(math.log2(len(scene))) + 1):
        after = after[after]
    reachable = shortest_distances(scene.graph, np.array([goal]))[:, 0] >= 0
    return np.asarray(reachable & (after != goal))
