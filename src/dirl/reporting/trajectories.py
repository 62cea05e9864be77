"""Paths of an agent on the map of its room, with its views on the way (as the paper's figure 6)."""

import math
import textwrap
from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray
from torch import nn

from dirl.evaluation.protocol import EvaluationProtocol
from dirl.reporting.style import draw_room, marker, write_figure
from dirl.reporting.tables import run_title
from dirl.runs.checkpoints import Summary
from dirl.scenes import ACTIONS, Scene
from dirl.scenes.graph import IntArray, places
from dirl.scenes.palette import COLORS, GOAL_COLOR, WALL_COLOR

DASHES: tuple[float, Sequence[float]] = (0, (2, 1.2))

EPISODES = 5
"""In a picture of paths."""

MAX_VIEWS = 8
"""Of a path; with the goal's they fill three rows of three."""

# Inches: the longer side of the map; the width of the views and the legend; the height of the views.
MAP_SIZE, SIDE_WIDTH, VIEWS_HEIGHT = 5.0, 4.9, 4.75

draw_arrows = partial(Axes.quiver, angles="xy", scale_units="xy", scale=1, units="inches")
draw_arrows = partial(draw_arrows, headwidth=5, headlength=5, headaxislength=4.5)

FloatArray = NDArray[np.floating]


def draw_trajectories(
    scene: Scene, goal: int, paths: Sequence[Sequence[int]], file: Path, *, success: Sequence[bool], title: str
) -> None:
    """Draw paths to one goal on the map of the room, and the views along the first of them, as a PNG.

    Of a scene without views only the map is drawn. A path is all states from the start to the end; one that follows
    itself is a blocked move. ``success`` says whether each ended in a stop at the goal; the others are dashed.

    Raises:
        ValueError: a path is empty or makes a step that the scene's graph does not allow, or the goal is no state that
            can be reached.
    """
    scene.check_goals([goal])
    for path in paths:
        path_actions(scene, path)
    sides = np.ptp(scene.positions, axis=0) + 2 * scene.step_length
    width, height = sides * MAP_SIZE / sides.max() + (0.8, 0.6)  # with room for the labels of the axes
    full_width = max(width, SIDE_WIDTH) if scene.views is None else width + SIDE_WIDTH
    title = textwrap.fill(title, int(11 * full_width))  # about 11 letters an inch
    title_height = 0.2 * (title.count("\n") + 1) + 0.1
    legend_height = 0.19 * math.ceil((len(paths) + 4) / 2) + 0.3
    if scene.views is None:
        height += title_height
        figure = Figure((full_width, height + legend_height), layout="constrained")
        main, side = figure.subfigures(2, 1, squeeze=False, height_ratios=(height, legend_height)).ravel()
    else:
        height = max(height + 0.2, VIEWS_HEIGHT + legend_height) + title_height
        figure = Figure((full_width, height), layout="constrained")
        main, side = figure.subfigures(1, 2, squeeze=False, width_ratios=(width, SIDE_WIDTH)).ravel()
        main.suptitle("paths to the goal", fontsize=10)
        _draw_views(side, scene, goal, paths[0], success[0])
    figure.suptitle(title)
    axes, square, place = main.subplots(), scene.step_length, places(scene.graph)
    arrows = square * scene.directions
    draw_room(axes, scene, square)
    handles: list[Artist] = []
    # Paths are set apart along the diagonal, so that they stay apart in corridors of both directions.
    apart = min(0.14, 0.6 / len(paths)) * square
    for number, (path, reached) in enumerate(zip(paths, success, strict=True)):
        at = scene.positions + (number - (len(paths) - 1) / 2) * apart
        line = _draw_path(axes, at, place, 0.32 * arrows, path, COLORS[number % len(COLORS)], reached)
        steps = len(path) - 1
        failed = "" if reached else ", failed"
        line.set_label(f"{number + 1}: from state {path[0]}, {steps} step{'' if steps == 1 else 's'}{failed}")
        handles.append(line)
    draw_arrows(axes, *scene.positions[[goal]].T, *0.9 * arrows[[goal]].T, color="black", width=1.8 / 72, zorder=6)
    axes.plot(*scene.positions[goal], "*", color=GOAL_COLOR, markersize=16, markeredgecolor="black", zorder=6)
    handles.append(marker("o", 7, "0.4", "white", "start; arrows: heading"))
    if not all(success):
        handles.append(marker("X", 10, "0.4", "white", "end of a failed path"))
    handles.append(marker("*", 12, GOAL_COLOR, "black", f"goal, state {goal}"))
    handles.append(Patch(color=WALL_COLOR, label="walls, furniture"))
    side.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False, fontsize=9, handlelength=3)
    write_figure(figure, file)


def draw_paths(
    policy: nn.Module, protocol: EvaluationProtocol, index: int, file: Path, *, facts: Summary
) -> tuple[int, list[int], bool, str]:
    """Draw greedy episodes to a scene's first goal, as `draw_scene` does.

    Returns:
        The goal, the path from the farthest start, whether it succeeded, and a title.
    """
    world, scene = protocol.world, protocol.world.scenes[index]
    goal_index, offset = world.goals_of[index][0], world.offsets[index]
    distances = world.block(world.distances, goal_index).long()
    order = torch.argsort(distances, descending=True, stable=True)[: int((distances > 0).sum())] + offset
    starts = order[torch.linspace(0, 0.9 * (len(order) - 1), min(EPISODES, len(order))).long()]
    episodes, paths = protocol.trajectories(policy, (torch.full_like(starts, goal_index), starts))
    goal = int(world.goals[goal_index]) - offset
    title = f"{run_title({**facts, 'scene': scene.name, 'source': scene.source})}, goal {goal}"
    walked = [[state - offset for state in path] for path in paths]
    success = episodes.success.tolist()
    draw_trajectories(scene, goal, walked, file, success=success, title=title)
    return goal, walked[0], success[0], title


def path_actions(scene: Scene, path: Sequence[int]) -> list[str]:
    """Return the actions between the states of a path, one fewer than states; "blocked" where the agent stayed."""
    if len(path) == 0:
        raise ValueError("a path holds at least its start")
    wrong = [state for state in path if not 0 <= state < len(scene)]
    if wrong:
        raise ValueError(f"{scene.name}: {wrong[0]} is not a state; states are 0..{len(scene) - 1}")
    actions = []
    for state, after in pairwise(path):
        leads = np.flatnonzero(scene.graph[state] == after)
        if state != after and not len(leads):
            raise ValueError(f"{scene.name}: no action leads from state {state} to state {after}")
        actions.append("blocked" if state == after else ACTIONS[leads[0]])
    return actions


def _draw_path(
    axes: Axes, at: FloatArray, place: IntArray, arrows: FloatArray, path: Sequence[int], color: str, reached: bool
) -> Line2D:
    """Draw one path, its states ``at`` ``[N, 2]`` and headed along ``arrows`` ``[N, 2]``; return its legend's line."""
    red, green, blue = to_rgb(color)
    pale = ((1 + red) / 2, (1 + green) / 2, (1 + blue) / 2)
    style: Literal["-"] | tuple[float, Sequence[float]] = "-" if reached else DASHES
    # One segment for each pair of places: dashes would close up where a path goes over itself.
    segments = {tuple(sorted(place[[a, b]])): (a, b) for a, b in pairwise(path) if place[a] != place[b]}
    ends = at[np.array(list(segments.values()), int).reshape(-1, 2)]
    lines = LineCollection(ends, colors=[pale], linestyles=[style], linewidths=2.5, zorder=3)
    lines.set_capstyle("round" if reached else "butt")
    axes.add_collection(lines)
    # An arrow for each state, however often it was visited; that of the start reaches out from under its dot.
    states = list(dict.fromkeys(path))
    lengths = np.ones((len(states), 1))
    lengths[0] = 2
    draw_arrows(axes, *at[states].T, *(lengths * arrows[states]).T, color=color, width=1 / 72, zorder=4)
    axes.plot(*at[path[0]], "o", color=color, markersize=7, markeredgecolor="white", zorder=5)
    if not reached:
        axes.plot(*at[path[-1]], "X", color=color, markersize=10, markeredgecolor="white", zorder=7)
    line = Line2D([], [], color=pale, linestyle=style, linewidth=2.5, marker="o", markersize=7)
    line.set(markerfacecolor=color, markeredgecolor="white")
    return line


def _draw_views(figure: SubFigure, scene: Scene, goal: int, path: Sequence[int], reached: bool) -> None:
    """Draw the views at some steps of a path, and the view at the goal."""
    assert scene.views is not None
    figure.suptitle("views along path 1, each with the action that follows", fontsize=10)
    actions = [*path_actions(scene, path), "goal reached" if reached else "failed"]
    steps = np.linspace(0, len(path) - 1, min(MAX_VIEWS, len(path))).round().astype(int).tolist()
    shown = [(f"step {step}: {actions[step]}", path[step]) for step in steps]
    shown.append(("goal", goal))
    grid = figure.subplots(3, 3).ravel()
    for axes in grid:
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set_visible(False)
    # Rendering scales the views down to the few pixels they take in the figure, which keeps the file small.
    for axes, (label, state) in zip(grid, shown, strict=False):
        axes.imshow(scene.views[state])
        axes.set_title(label, fontsize=9)
    for axes, color in ((grid[len(shown) - 2], COLORS[0]), (grid[len(shown) - 1], GOAL_COLOR)):
        axes.spines[:].set(visible=True, color=color, linewidth=3)
