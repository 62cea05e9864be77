"""What the experiments' figures share: panels, and how they are saved."""

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dirl.reporting.style import plain, write_figure


def panels(count: int, size: tuple[float, float]) -> tuple[Figure, list[Axes]]:
    """Make a figure of so many panels side by side, ``size`` in inches."""
    figure = Figure(figsize=size, layout="constrained")
    grid = list(figure.subplots(1, count, sharey=True, squeeze=False)[0])
    for axes in grid:
        plain(axes)
    return figure, grid


def save_figure(figure: Figure, out: Path, name: str) -> None:
    """Write a figure as PNG and SVG."""
    out.mkdir(parents=True, exist_ok=True)
    write_figure(figure, out / f"{name}.png")
    write_figure(figure, out / f"{name}.svg", dpi=100)
