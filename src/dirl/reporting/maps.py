"""Maps of a room with the policy, the state value and the matching coefficient of every state."""

import math
import textwrap
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import ArrayLike, NDArray

from dirl.reporting.style import draw_room, star, write_figure
from dirl.scenes import ACTIONS, Scene
from dirl.scenes.geometry import heading_directions, step_length
from dirl.scenes.graph import AHEAD, BACK, LEFT, RIGHT, shortest_distances, turns_per_circle
from dirl.scenes.palette import COLORS, GOAL_COLOR, WALL_COLOR

FloatArray = NDArray[np.floating]

LOST_COLOR, MATCH_COLOR = "#3A3A3A", "#00B7FF"
MAP_WIDTH, LEGEND_HEIGHT = 4.8, 0.5
"""Inches: of each map, and of the legend below them."""


def draw_policy(
    scene: Scene,
    goal: int,
    probabilities: ArrayLike,
    value: ArrayLike,
    matching: ArrayLike,
    file: Path,
    *,
    title: str,
    threshold: float = 0.9,
) -> None:
    """Draw three maps side by side, as a PNG: most probable action, state value, matching coefficient.

    Every cell is split into one wedge for each heading, on the side that the heading faces.

    Args:
        scene: N states.
        goal: a state of the scene; the policy's, the value's and the matching's.
        probabilities: of the actions in each state, float ``[N, 4]`` in the order of `ACTIONS`.
        value: of each state, float ``[N]``.
        matching: of each state with the goal, float ``[N]``, see `dirl.perception.recognition.matching.TemplateStop`.
        file: the image to write.
        title: of the figure.
        threshold: states that match better than this are outlined: there the agent stops.

    Raises:
        ValueError: the goal is no state that can be reached.
    """
    scene.check_goal(goal)
    chances, values, scores = (np.asarray(each, float) for each in (probabilities, value, matching))
    directions = heading_directions(scene)
    side = step_length(scene)
    wedges = wedge_corners(scene.positions, directions, side, turns_per_circle(scene.graph))

    spans = np.ptp(scene.positions, axis=0) + 2 * side
    # Maps of tall, narrow rooms are drawn smaller, not taller than a page.
    width = min(MAP_WIDTH, 1.1 * MAP_WIDTH * spans[0] / spans[1])
    height = width * spans[1] / spans[0]
    full_width = 3 * max(width, 3.2) + 1.6
    title = textwrap.fill(title, int(11 * full_width))
    figure = Figure((full_width, height + 0.5 + LEGEND_HEIGHT + 0.25 * (title.count("\n") + 1)), layout="constrained")
    figure.suptitle(title)
    maps = policy_map, value_map, matching_map = figure.subplots(1, 3, sharex=True, sharey=True)
    titles = "most probable action", "state value", "matching with the goal's views"
    for axes, shown in zip(maps, titles, strict=True):
        draw_room(axes, scene, side)
        axes.set_anchor("C")  # as a colour bar sets it for the maps that have one
        axes.set_title(shown, fontsize=10)
        axes.label_outer()

    lost = never_arrives(scene, goal, chances.argmax(1))
    middles = scene.positions + 0.31 * side * directions
    # A quarter of the cell has room for a glyph of a third of its side; narrower wedges for less.
    glyph = 0.34 * side * min(1.0, 1.6 * math.tan(math.pi / turns_per_circle(scene.graph)))
    _draw_actions(policy_map, wedges, middles, directions, glyph, chances, lost)
    _draw_heat(value_map, wedges, values, values.min(), values.max(), "viridis")
    _draw_heat(matching_map, wedges, scores, min(scores.min(), threshold), 1, "magma", threshold)
    above = np.flatnonzero(scores > threshold)
    outline = PolyCollection(list(wedges[above]), facecolors="none", edgecolors=MATCH_COLOR, linewidths=1.6, zorder=5)
    matching_map.add_collection(outline)
    # At the goal no action is left.
    done = PolyCollection([wedges[goal]], facecolors=GOAL_COLOR, edgecolors="black", linewidths=1, zorder=4)
    policy_map.add_collection(done)
    size = min(0.4 * 72 * width * side / spans[0], 13)  # points
    for axes in maps:
        axes.plot(*middles[goal], "*", color=GOAL_COLOR, markersize=size, markeredgecolor="black", zorder=7)
    figure.legend(
        handles=_legend(goal, int(lost.sum()), len(above), threshold),
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


def wedge_corners(positions: FloatArray, directions: FloatArray, side: float, turns: int) -> FloatArray:
    """Return the part of its cell that a state takes: centre, corner, middle of side, corner; metres, ``[N, 4, 2]``.

    Of the centres of cells, ``[N, 2]``, unit vectors of the headings, ``[N, 2]``, the side of a cell, metres, and the
    headings in a full circle: the wedges of a place fill its cell.
    """
    half = math.pi / turns
    corners = [np.zeros_like(directions)]
    for angle in (-half, 0.0, half):
        turned = directions @ np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
        longer = np.abs(turned).max(1, keepdims=True)
        corners.append(0.5 * side * turned / np.where(longer > 0, longer, 1))
    return np.asarray(positions[:, None] + np.stack(corners, 1))


def _draw_actions(
    axes: Axes,
    wedges: FloatArray,
    middles: FloatArray,
    directions: FloatArray,
    glyph: float,
    chances: FloatArray,
    lost: NDArray[np.bool_],
) -> None:
    """Draw a wedge for each state, in a stronger colour for a higher probability, with a glyph of the action.

    ``glyph`` is its height, metres.
    """
    actions = chances.argmax(1)
    colors = np.array([to_rgb(color) for color in COLORS[: len(ACTIONS)]])[actions]
    # Evenly divided chances are white; full colour stays pale enough for a black glyph on it.
    sure = 0.7 * np.clip((chances.max(1) - 0.25) / 0.75, 0, 1)[:, None]
    faces = 1 - sure * (1 - colors)
    faces[lost] = to_rgb(LOST_COLOR)
    axes.add_collection(PolyCollection(list(wedges), facecolors=faces, edgecolors="white", linewidths=0.5, zorder=2))
    # The glyph's own "up" comes to lie along the heading.
    glyphs = [
        middle + glyph * GLYPHS[action] @ np.array([[direction[1], -direction[0]], direction])
        for middle, direction, action in zip(middles, directions, actions, strict=True)
    ]
    inks = np.where(lost[:, None], 0.5 + 0.5 * colors, 0.05)
    axes.add_collection(PolyCollection(glyphs, facecolors=inks, linewidths=0, zorder=3))


def _turning_arrow() -> FloatArray:
    """Return the outline ``[K, 2]`` of an arrow from below that bends to the right, in a square of side 1."""
    bend = np.linspace(math.pi, math.pi / 2, 7)
    centre = np.array([0.04, -0.1])
    outer, inner = (centre + radius * np.stack([np.cos(bend), np.sin(bend)], 1) for radius in (0.4, 0.24))
    head = np.array([(0.06, 0.5), (0.5, 0.22), (0.06, -0.06)])
    return np.concatenate([[(-0.36, -0.42)], outer, head, inner[::-1], [(-0.2, -0.42)]])


STRAIGHT_ARROW = np.array(
    [(-0.08, -0.42), (0.08, -0.42), (0.08, 0.02), (0.34, 0.02), (0, 0.46), (-0.34, 0.02), (-0.08, 0.02)]
)

GLYPHS = {
    AHEAD: STRAIGHT_ARROW,
    RIGHT: _turning_arrow(),
    LEFT: _turning_arrow() * (-1, 1),
    BACK: STRAIGHT_ARROW * (1, -1),
}
"""The outline of each action's arrow, ``[K, 2]`` in a square of side 1, for an agent that looks up."""


def _draw_heat(
    axes: Axes,
    wedges: FloatArray,
    values: FloatArray,
    low: float,
    high: float,
    cmap: str,
    threshold: float | None = None,
) -> None:
    """Draw a wedge for each state, coloured by its value, and the scale beside the map."""
    colors = ScalarMappable(Normalize(low, high), cmap)
    heat = PolyCollection(list(wedges), facecolors=colors.to_rgba(values), edgecolors="face", linewidths=0.2, zorder=2)
    axes.add_collection(heat)
    bar = axes.figure.colorbar(colors, ax=axes, shrink=0.8, aspect=30, pad=0.02)
    bar.outline.set_visible(False)
    if threshold is not None:
        bar.ax.axhline(threshold, color=MATCH_COLOR, linewidth=2)


def _legend(goal: int, lost: int, above: int, threshold: float) -> list[Patch | Line2D]:
    handles: list[Patch | Line2D] = []
    for name, color in zip(("ahead", "turn right", "turn left", "back"), COLORS, strict=False):
        handles.append(Patch(color=tuple(1 - 0.7 * (1 - np.array(to_rgb(color)))), label=name))
    if lost:
        handles.append(Patch(color=LOST_COLOR, label=f"never arrives, {lost} state{'' if lost == 1 else 's'}"))
    label = f"matches above {threshold:g}, {above} state{'' if above == 1 else 's'}"
    handles.append(Patch(facecolor="none", edgecolor=MATCH_COLOR, linewidth=1.6, label=label))
    return [*handles, star(11, f"goal, state {goal}"), Patch(color=WALL_COLOR, label="walls, furniture")]
