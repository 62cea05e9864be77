"""The common style of all figures: colours, axes, and how they are saved."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from dirl.scenes.io.atomic import atomic_path


def tell_cut(axes: Axes, name: str = "y") -> None:
    """Say in the label of a linear axis that it does not begin at zero, if so.

    Args:
        axes: whose limits are final.
        name: ``x`` or ``y``.
    """
    axis = axes.xaxis if name == "x" else axes.yaxis
    low, high = sorted(axis.get_view_interval())
    if axis.get_scale() == "linear" and low > 0.05 * high:
        axis.set_label_text(f"{axis.get_label_text()}\n(axis begins at {low:.3g})")


def plain(axes: Axes, grid: str = "both") -> None:
    """A pale grid behind what is drawn, and no frame above and at the right.

    Args:
        axes: drawn on.
        grid: ``both``, or the axis that gets grid lines, ``x`` or ``y``.
    """
    axes.grid(axis=grid, color="0.9")  # type: ignore[arg-type]
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def write_figure(figure: Figure, file: Path, dpi: int = 120) -> None:
    """Write a figure in the format that the file's name ends with, PNG or SVG, completely or not at all."""
    canvas = FigureCanvasAgg(figure)
    with atomic_path(file) as temporary:
        if file.suffix == ".png":
            # Matplotlib's own function goes through the figure twice, keeps an opaque alpha channel, and compresses at
            # Pillow's level 6, which takes twice the time and saves 8% of the size.
            figure.set_dpi(dpi)
            canvas.draw()
            Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB").save(temporary, compress_level=3)
        else:
            canvas.print_figure(temporary, dpi=dpi)
