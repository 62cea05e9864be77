"""What all figures share: their colours, how plain axes look, and how they become files."""

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dirl.atomic import atomic_path

# The Okabe-Ito palette, which colour-blind readers can tell apart; its yellow is the goal's on maps.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")
BLUE, VERMILION, GREEN, PURPLE, SKY, _ = COLORS


def plain(axes: Axes, grid: str = "both") -> None:
    """A pale grid behind what is drawn, and no frame above and at the right.

    Args:
        axes: drawn on.
        grid: ``both``, or the axis whose lines there are, ``x`` or ``y``.
    """
    axes.grid(axis=grid, color="0.9")  # type: ignore[arg-type]
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def write_figure(figure: Figure, file: Path, dpi: int = 120) -> None:
    """Write a figure in the format that the file's name ends with, PNG or SVG; the file is whole or not there."""
    with atomic_path(file) as temporary:
        FigureCanvasAgg(figure).print_figure(temporary, dpi=dpi)
