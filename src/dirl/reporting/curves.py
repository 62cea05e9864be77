"""The learning curve of a run, drawn from the files in its folder."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, LogLocator, MaxNLocator, NullLocator, StrMethodFormatter
from numpy.typing import NDArray

from dirl.evaluation.protocol import STABLE_ATL, WINDOW
from dirl.reporting.style import plain, write_figure
from dirl.reporting.tables import read_columns, run_title
from dirl.runs.checkpoints import Summary
from dirl.scenes.io.files import read_text
from dirl.scenes.palette import BLUE, GREEN, PURPLE, SKY, VERMILION

FloatArray = NDArray[np.float64]


def draw_learning_curve(folder: Path, file: Path) -> None:
    """Draw a run: ATL, and SR and SPL of the greedy evaluation, over frames, as a PNG.

    Its folder holds ``summary.json``, and a table for each stage that has written any rows. A run of imitation alone,
    with ``imitation.csv`` but no ``reinforcement.csv``, is drawn as the loss and accuracy of its steps.

    Raises:
        FileNotFoundError: there is no ``summary.json``.
    """
    summary = json.loads(read_text(folder / "summary.json"))
    figure = Figure(figsize=(8.5, 5.5), layout="constrained")
    figure.suptitle(run_title(summary))
    upper, lower = figure.subplots(2, sharex=True)
    if (folder / "imitation.csv").is_file() and not (folder / "reinforcement.csv").is_file():
        _draw_imitation(upper, lower, folder)
    else:
        _draw_reinforcement(upper, lower, folder, summary)
    for axes in (upper, lower):
        plain(axes)
    figure.align_ylabels()
    write_figure(figure, file)


def atl_axis(axes: Axes, label: str) -> None:
    """Set a logarithmic y axis of steps, with round numbers."""
    axes.set(yscale="log", ylabel=label)
    axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))


def common_frames(runs: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
    """Return frames ``[F]`` within every run, and the values there ``[R, F]``; runs are frames and values ``[K]``."""
    if any(len(frames) == 0 for frames, _ in runs):
        return np.empty(0), np.empty((len(runs), 0))
    first, last = max(frames[0] for frames, _ in runs), min(frames[-1] for frames, _ in runs)
    frames = np.unique(np.concatenate([frames for frames, _ in runs]))
    frames = frames[(frames >= first) & (frames <= last)]
    return frames, np.stack([np.interp(frames, *run) for run in runs])


def _draw_reinforcement(upper: Axes, lower: Axes, folder: Path, summary: Summary) -> None:
    training = read_columns(folder / "reinforcement.csv", "frames", "atl", "atl_worst_goal")
    evaluation = read_columns(folder / "evaluation.csv", "frames", "atl", "sr", "spl")
    shortest = summary["greedy"]["shortest"]
    frames = evaluation["frames"]
    _draw_line(upper, training["frames"], training["atl_worst_goal"], SKY, "training, worst goal")
    label = f"training, mean of goals,\nlast {WINDOW} episodes of each"
    _draw_line(upper, training["frames"], training["atl"], BLUE, label)
    _draw_line(upper, frames, evaluation["atl"], VERMILION, "greedy evaluation")
    upper.axhline(STABLE_ATL, color="0.3", linestyle="--", linewidth=1, label=f"stability limit, {STABLE_ATL:g}")
    label = f"shortest path of the evaluation, {shortest:.2f};\ntraining draws starts of its own"
    upper.axhline(shortest, color="0.3", linestyle=":", linewidth=1.5, label=label)
    atl_axis(upper, "ATL (steps, log scale)")
    _draw_line(lower, frames, evaluation["sr"], GREEN, "SR, greedy evaluation")
    _draw_line(lower, frames, evaluation["spl"], PURPLE, "SPL, greedy evaluation")
    lower.set(ylabel="SR, SPL", ylim=(-0.03, 1.03))
    if (stable := summary["stable_at_frame"]) is not None:
        upper.axvline(stable, color="0.3", linestyle="-.", linewidth=1, label=f"stable at {stable:,} frames")
        lower.axvline(stable, color="0.3", linestyle="-.", linewidth=1)
    for axes in (upper, lower):
        if axes.get_legend_handles_labels()[0]:  # no episode has ended yet in a short run
            axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1), frameon=False)
    # A little room on the left keeps the evaluation at frame 0 off the axis.
    end = max(summary["frames"], 1)
    lower.set(xlim=(-0.02 * end, 1.02 * end), xlabel="frames")
    lower.xaxis.set_major_locator(MaxNLocator(6, integer=True, steps=(1, 2, 5, 10)))
    lower.xaxis.set_major_formatter(EngFormatter())


def _draw_imitation(upper: Axes, lower: Axes, folder: Path) -> None:
    imitation = read_columns(folder / "imitation.csv", "step", "loss", "accuracy")
    _draw_line(upper, imitation["step"], imitation["loss"], BLUE)
    upper.set_ylabel("loss")
    upper.set_ylim(bottom=0)
    _draw_line(lower, imitation["step"], imitation["accuracy"], GREEN)
    lower.set(ylabel="accuracy", ylim=(-0.03, 1.03), xlabel="steps of imitation")


def _draw_line(axes: Axes, x: FloatArray, y: FloatArray, color: str, label: str = "") -> None:
    """Draw a line through the finite values; where they are few, points mark them, as a single one has no line."""
    known = np.isfinite(y)
    if not known.any():
        return
    marker = "o" if known.sum() <= 50 else ""
    axes.plot(x[known], y[known], color=color, label=label, linewidth=1.5, marker=marker, markersize=3.5)
