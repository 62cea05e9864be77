"""The results of a sweep at its end: a table of its runs, and their spread where they differ in their seed only."""

import json
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from hydra.experimental.callback import Callback
from omegaconf import DictConfig

from dirl.config.files import leaves, plain_mapping
from dirl.reporting.tables import result_table
from dirl.runs.checkpoints import Summary
from dirl.scenes.io.files import read_text

FEW = 4
"""Runs of which there is no spread to tell."""

SPREAD = {"SR": ("greedy", "sr"), "SPL": ("greedy", "spl"), "ATL": ("greedy", "atl"), "stable at": ("stable_at_frame",)}
"""What of a summary its spread is told of, and where it stands."""


class SweepTable(Callback):
    """Prints a table of the runs of a sweep when its jobs are done: Hydra's ``on_multirun_end``."""

    def on_multirun_end(self, config: DictConfig, **kwargs: object) -> None:
        """Print it; a run that failed has no summary, and no row."""
        swept, folder = config.hydra, Path(config.hydra.sweep.dir)
        given = [override.partition("=")[0].lstrip("+~") for override in swept.overrides.task]
        runs = finished(folder)
        if len(runs) > 1:
            table = sweep_table(runs, folder, {*given, *(swept.sweeper.get("params") or {})})
            print(f"\nGreedy policies of {folder}:\n\n{table}")
        if len(runs) >= FEW and differing(runs) == {"seed"}:
            summaries = [run.summary for run in runs]
            print(f"\nOver the seeds:\n\n{seed_table(summaries)}")


class Swept(NamedTuple):
    """A finished run of a sweep."""

    folder: Path
    config: dict[str, object]
    """Values by dotted name."""
    summary: Summary


def finished(folder: Path) -> list[Swept]:
    """Return the evaluated runs below a folder, job 2 before job 10."""
    runs = []
    for file in sorted(folder.glob("**/summary.json"), key=lambda file: (len(file.parent.name), str(file))):
        summary, config = json.loads(read_text(file)), file.with_name("config.yaml")
        if config.is_file() and "greedy" in summary:
            runs.append(Swept(file.parent, leaves(plain_mapping(read_text(config))), summary))
    return runs


def differing(runs: Sequence[Swept]) -> set[str]:
    """Return the options in which runs differ."""
    names = {name for run in runs for name in run.config}
    return {name for name in names if len({str(run.config.get(name)) for run in runs}) > 1}


def sweep_table(runs: Sequence[Swept], folder: Path, options: Collection[str]) -> str:
    """Return the greedy measures of runs in a sweep's folder, Markdown.

    Of the options that were given, by name, those that differ between the runs tell them apart.
    """
    inside = tuple(f"{option}." for option in options)
    chosen = [name for name in sorted(differing(runs)) if f"{name}.".startswith(inside)]
    rows = {}
    for run in runs:
        label = ", ".join(_told(name, run.config.get(name)) for name in chosen)
        name = str(run.folder.relative_to(folder))
        rows[f"{name}: {label}" if label else name] = run.summary["greedy"]
    return result_table(rows, leave_out=["false", "missed", "episodes"])


def _told(name: str, value: object) -> str:
    """Return an option and its value in few letters: its last name, of a component its group and class."""
    group, _, last = name.rpartition(".")
    return f"{group}={str(value).rpartition('.')[2]}" if last == "_target_" else f"{last}={value}"


def seed_table(summaries: Sequence[Summary]) -> str:
    """Return the spread of runs, Markdown: of each measure mean, standard deviation, lowest, quartiles and highest.

    Runs that never became stable are counted, and are in no other number of that row.
    """
    lines = ["| | runs | mean | sd | lowest | quarter | median | three quarters | highest |", "|---" + "|--:" * 8 + "|"]
    for name, (*groups, last) in SPREAD.items():
        inner = [summary[groups[0]] if groups else summary for summary in summaries]
        values = np.array([summary[last] for summary in inner if summary[last] is not None], float)
        if not len(values):
            lines.append(f"| {name} | 0 of {len(summaries)} |" + " - |" * 7)
            continue
        numbers = [values.mean(), values.std(), *np.quantile(values, (0, 0.25, 0.5, 0.75, 1))]
        shown = [f"{number:,.0f}" if values.max() > 1000 else f"{number:.3f}" for number in numbers]
        lines.append(f"| {name} | {len(values)} of {len(summaries)} | {' | '.join(shown)} |")
    return "\n".join(lines)
