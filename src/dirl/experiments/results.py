"""Finished runs on disk, the paper's numbers, and tables and figures as files."""

import csv
import json
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from dirl.config.saved import read_config
from dirl.config.schemas import TrainConfig
from dirl.reporting.statistics import summarised
from dirl.reporting.style import write_figure
from dirl.runs.checkpoints import load_checkpoint
from dirl.runs.checks import RunError
from dirl.runs.finding import finished_folders
from dirl.scenes.io.atomic import atomic_path, write_text
from dirl.scenes.io.texts import read_rows, read_text
from dirl.scenes.palette import SYSTEM_COLORS
from dirl.training.load import Trained, load_trained

NAMES = {
    "shortest_path": "shortest path",
    "random": "random",
    "il": "IL",
    "dagger": "DAgger",
    "a3c": "A3C",
    "td_drl": "TD-DRL",
    "dirl": "DIRL",
    "dirl_ppo": "DIRL with PPO",
    "dirl_compared": "DIRL, compared",
    "any_goal": "DIRL, many goals",
}
"""Systems by the name they have in a configuration, in the order of the tables."""

COLOR_OF = {name: SYSTEM_COLORS[system] for system, name in NAMES.items()}
"""The colour of each system in every figure, by its name in the tables."""


@dataclass(frozen=True)
class Result:
    """A finished run."""

    folder: Path
    config: TrainConfig
    summary: Mapping[str, Any]

    @property
    def total(self) -> int:
        """The number of frames of its training."""
        return int(self.summary["frames"])

    @property
    def scenes(self) -> list[str]:
        """The names of the scenes it was made in."""
        names = self.summary["scene"]
        return [names] if isinstance(names, str) else names

    def load(self, changes: Mapping[str, Any] | None = None) -> Trained:
        """Its policy with the final weights; ``changes`` are options to replace, by dotted name."""
        return load_trained(load_checkpoint(self.folder), str(self.folder), changes)

    def table(self, stage: str) -> dict[str, NDArray[np.float64]]:
        """The columns of ``<stage>.csv``; an empty cell is NaN."""
        rows = read_rows(self.folder / f"{stage}.csv")
        return {name: np.array([float(row[name] or "nan") for row in rows]) for name in rows[0]} if rows else {}


def finished_runs(folder: Path, hint: str) -> list[Result]:
    """The finished runs right in a folder, by name; those that are not finished are named on the terminal.

    Args:
        folder: holds a folder for each run.
        hint: how to make them, for the error.

    Raises:
        RunError: there is none.
    """
    folders, unfinished = finished_folders(folder, hint)
    if unfinished:
        print(f"not finished, left out: {', '.join(one.name for one in unfinished)}")
    found = [
        Result(
            one,
            read_config(read_text(one / "config.yaml"), origin=str(one / "config.yaml")),
            json.loads(read_text(one / "summary.json")),
        )
        for one in folders
    ]
    # Of a collection, experiments compare runs that have more rooms with runs that have fewer.
    scenes = {str(one.config.scene if one.config.split else one.summary["scene"]) for one in found}
    if len(scenes) > 1:
        raise RunError(f"{folder}: holds runs of different scenes, {' and '.join(sorted(scenes))}; report them apart")
    return found


def grouped(results: Sequence[Result], key: Callable[[TrainConfig], Any]) -> dict[Any, list[Result]]:
    """Runs grouped by a function of their configuration, in their order."""
    groups: dict[Any, list[Result]] = {}
    for result in results:
        groups.setdefault(key(result.config), []).append(result)
    return groups


def by_system(results: Sequence[Result]) -> dict[str, list[Result]]:
    """Runs by system, in the order of `NAMES`."""
    groups = grouped(results, lambda config: config.system)
    return {name: groups[name] for name in [*NAMES, *sorted(set(groups) - set(NAMES))] if name in groups}


def published(experiment: str) -> dict[str, Any]:
    """The paper's numbers, and under ``source`` their place in it."""
    text = (Path(__file__).parent / "published.toml").read_text()
    return tomllib.loads(text)[experiment]


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Args:
        heading: above it.
        form: of its numbers, as for `format`.
    """

    heading: str
    form: str = ""


class Table:
    """Rows of texts, numbers, and lists of numbers (one for each run, shown as mean and interval).

    Args:
        columns: of it.
    """

    def __init__(self, *columns: Column) -> None:
        self.columns = columns
        self.rows: list[tuple[Any, ...]] = []

    def add(self, *cells: Any) -> None:
        """Add a row; None stays empty."""
        assert len(cells) == len(self.columns)
        self.rows.append(cells)

    def markdown(self) -> str:
        """The table as Markdown."""
        lines = [[column.heading for column in self.columns], [":--" if not c.form else "--:" for c in self.columns]]
        for row in self.rows:
            lines.append([self._text(cell, column) for cell, column in zip(row, self.columns, strict=True)])
        return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"

    @staticmethod
    def _text(cell: Any, column: Column) -> str:
        if cell is None:
            return ""
        if isinstance(cell, list):
            return summarised(cell, column.form)
        return format(cell, column.form) if column.form and not isinstance(cell, str) else str(cell)

    def write_csv(self, file: Path) -> None:
        """A row for each run: rows without lists once, else one for each place in the lists, numbered as ``run``."""
        with atomic_path(file) as temporary, temporary.open("w", newline="") as stream:
            writer = csv.writer(stream)
            writer.writerow([*(column.heading for column in self.columns), "run"])
            for row in self.rows:
                runs = max((len(cell) for cell in row if isinstance(cell, list)), default=1)
                for run in range(runs):
                    # Lists may be shorter: not every room has episodes of every distance.
                    cells = [([*cell, *[None] * runs][run]) if isinstance(cell, list) else cell for cell in row]
                    writer.writerow([*("" if cell is None else cell for cell in cells), run])


def write_tables(out: Path, title: str, note: str, tables: Mapping[str, Table], figures: Mapping[str, str]) -> str:
    """Write ``<name>.csv`` for each table, and ``README.md`` with all of them and the figures; returns its text.

    Args:
        out: a folder.
        title: of the text.
        note: above the tables.
        tables: by the name of their file.
        figures: what each shows, for readers who do not see it, by the name of its file.
    """
    parts = [f"# {title}", note]
    for name, table in tables.items():
        table.write_csv(out / f"{name}.csv")
        parts.append(table.markdown().rstrip())
    parts += [f"![{shown}]({name}.png)" for name, shown in figures.items()]
    text = "\n\n".join(parts) + "\n"
    write_text(out / "README.md", text)
    return text


def save_figure(figure: Figure, out: Path, name: str) -> None:
    """Write a figure as PNG and SVG."""
    write_figure(figure, out / f"{name}.png")
    write_figure(figure, out / f"{name}.svg", dpi=100)
