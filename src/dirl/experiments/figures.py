"""What the experiments' figures share: panels, and interquartile means with their 95 % intervals drawn in four ways."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from dirl.reporting.statistics import bootstrap_interval, iqm
from dirl.reporting.style import plain, write_figure


def panels(count: int, size: tuple[float, float], *, sharey: bool = True) -> tuple[Figure, list[Axes]]:
    """A figure of so many panels side by side, ``size`` in inches."""
    figure = Figure(figsize=size, layout="constrained")
    grid = list(figure.subplots(1, count, sharey=sharey, squeeze=False)[0])
    for axes in grid:
        plain(axes)
    return figure, grid


def band(axes: Axes, x: ArrayLike, values: ArrayLike, color: str, label: str | None, **style: Any) -> None:
    """A line through the means of ``values`` ``[R, K]`` of R runs, in a band of their intervals."""
    low, high = bootstrap_interval(values)
    axes.fill_between(x, low, high, color=color, alpha=0.2, linewidth=0)
    axes.plot(x, iqm(values), color=color, label=label, **style)


def interval_row(axes: Axes, place: float, values: Sequence[float], color: str) -> None:
    """A mean as a point on a thick line, its interval, at a height."""
    low, high = bootstrap_interval(values)
    axes.plot([low, high], [place, place], color=color, linewidth=5, alpha=0.35, solid_capstyle="butt")
    axes.plot(iqm(values), place, "o", color=color)


WORDS = {
    "rooms_2cm": "2 cm",
    "rooms_5cm": "5 cm",
    "rooms_10cm": "10 cm",
    "later_lit": "relit",
    "later_moved": "refurnished",
    "later_height": "seen from\nhigher up",
    "later_all": "all changes",
    "ncc": "the paper's correlation",
    "learned, localising": "trained recogniser, Bayes filter",
    "image graph, ncc": "topological map by correlation",
}
"""What figures say instead of the names of collections and of ways to recognise."""

Line = tuple[str, str, str, Mapping[str, Sequence[Sequence[float]]]]
"""Label, colour, marker, and by the way goals are shown SPL in each room of each collection."""


def draw_spl(lines: Sequence[Line], names: Sequence[str], out: Path, name: str, *, apart: float = 0.0) -> None:
    """SPL over collections, by their names, a panel for each way of showing goals.

    The points of lines are ``apart``, where one collection is 1.
    """
    figure, grid = panels(2, (8, 4.6))
    views = list(lines[0][3])
    for axes, view in zip(grid, views, strict=True):
        for step, (label, color, marker, spl) in enumerate(lines):
            means = np.array([iqm(rooms) for rooms in spl[view]])
            low, high = np.array([bootstrap_interval(rooms) for rooms in spl[view]]).T
            x = np.arange(len(names)) + apart * (step - (len(lines) - 1) / 2)
            error = np.maximum(0.0, [means - low, high - means])
            agent, _, way = label.rpartition(": ")
            shown = ": ".join(filter(None, [agent, WORDS.get(way, way).replace(", told", ", told where to stop")]))
            named = shown if view == views[0] else None
            axes.errorbar(x, means, error, fmt=marker, color=color, markersize=3.5, capsize=2, label=named)
        turned: dict[str, Any] = {"rotation": 30, "ha": "right"} if len(names) > 3 else {}
        axes.set_xticks(range(len(names)), [WORDS.get(name, name.replace("_", " ")) for name in names], **turned)
        axes.set(title=view, ylim=(-0.03, 1.03), ylabel="SPL" if view == views[0] else None)
        axes.tick_params(axis="x", labelsize="small")
    figure.legend(
        loc="outside lower center", ncols=3, frameon=False, fontsize="small", columnspacing=1.0, handlelength=1.5
    )
    save_figure(figure, out, name)


def save_figure(figure: Figure, out: Path, name: str) -> None:
    """Write a figure as PNG and SVG."""
    out.mkdir(parents=True, exist_ok=True)
    write_figure(figure, out / f"{name}.png")
    write_figure(figure, out / f"{name}.svg", dpi=100)
