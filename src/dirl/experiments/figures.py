"""What the experiments' figures share: panels, and interquartile means with their 95 % intervals drawn in two ways."""

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from dirl.reporting.statistics import bootstrap_interval, iqm
from dirl.reporting.style import plain, write_figure


def panels(count: int, size: tuple[float, float]) -> tuple[Figure, list[Axes]]:
    """Make a figure of so many panels side by side, ``size`` in inches."""
    figure = Figure(figsize=size, layout="constrained")
    grid = list(figure.subplots(1, count, sharey=True, squeeze=False)[0])
    for axes in grid:
        plain(axes)
    return figure, grid


def band(axes: Axes, x: ArrayLike, values: ArrayLike, color: str, label: str | None) -> None:
    """Draw a line through the means of ``values`` ``[R, K]`` of R runs, in a band of their intervals."""
    low, high = bootstrap_interval(values)
    axes.fill_between(x, low, high, color=color, alpha=0.2, linewidth=0)
    axes.plot(x, iqm(values), color=color, label=label, linewidth=1.6)


def interval_row(axes: Axes, place: float, values: Sequence[float], color: str) -> None:
    """Draw a mean as a point on a thick line, its interval, at a height."""
    low, high = bootstrap_interval(values)
    axes.plot([low, high], [place, place], color=color, linewidth=5, alpha=0.35, solid_capstyle="butt")
    axes.plot(iqm(values), place, "o", color=color)


def save_figure(figure: Figure, out: Path, name: str) -> None:
    """Write a figure as PNG and SVG."""
    out.mkdir(parents=True, exist_ok=True)
    write_figure(figure, out / f"{name}.png")
    write_figure(figure, out / f"{name}.svg", dpi=100)
