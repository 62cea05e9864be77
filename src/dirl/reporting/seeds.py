"""The spread of runs that differ in their seed only, as a table and a picture."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from dirl.reporting.style import plain, write_figure
from dirl.reporting.tables import run_title
from dirl.scenes.palette import BLUE

FEW = 4
"""Runs of which there is no spread to tell."""

MEASURES = {
    "SR": ("greedy", "sr"),
    "SPL": ("greedy", "spl"),
    "ATL": ("greedy", "atl"),
    "stable at": ("stable_at_frame",),
}


def seed_table(summaries: Sequence[Mapping[str, Any]]) -> str:
    """The spread of runs, Markdown: of each measure mean, standard deviation, lowest, quartiles and highest.

    Runs that never became stable are counted, and are in no other number of that row.
    """
    lines = ["| | runs | mean | sd | lowest | quarter | median | three quarters | highest |", "|---" + "|--:" * 8 + "|"]
    for name, keys in MEASURES.items():
        values = _values(summaries, keys)
        if not len(values):
            lines.append(f"| {name} | 0 of {len(summaries)} |" + " - |" * 7)
            continue
        numbers = [values.mean(), values.std(), *np.quantile(values, (0, 0.25, 0.5, 0.75, 1))]
        shown = [f"{number:,.0f}" if values.max() > 1000 else f"{number:.3f}" for number in numbers]
        lines.append(f"| {name} | {len(values)} of {len(summaries)} | {' | '.join(shown)} |")
    return "\n".join(lines)


def draw_seeds(summaries: Sequence[Mapping[str, Any]], file: Path) -> None:
    """Draw which part of the runs reaches an SPL, and is stable by a frame, as a PNG."""
    figure = Figure(figsize=(8.5, 3.5), layout="constrained")
    figure.suptitle(f"{run_title({**summaries[0], 'seed': None})}, {len(summaries)} seeds")
    for axes, name in zip(figure.subplots(1, 2, sharey=True), ("SPL", "stable at"), strict=True):
        values = np.sort(_values(summaries, MEASURES[name]))
        axes.step(values, np.arange(1, len(values) + 1) / len(summaries), where="post", color=BLUE)
        axes.plot(values, np.zeros_like(values), "|", color=BLUE, markersize=12)
        axes.set(xlabel="SPL, greedy" if name == "SPL" else "stable at frame", ylim=(0, 1.02))
        plain(axes)
    figure.axes[0].set_ylabel("fraction of the seeds at or below")
    write_figure(figure, file)


def _values(summaries: Sequence[Mapping[str, Any]], keys: Sequence[str]) -> Any:
    found = []
    for summary in summaries:
        value: Any = summary
        for key in keys:
            value = value[key]
        if value is not None:
            found.append(float(value))
    return np.array(found)
