"""Finished runs on disk, the paper's numbers, and tables as files."""

import csv
import json
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from dirl.config.files import read_config
from dirl.config.schemas import TrainConfig
from dirl.reporting.statistics import FloatArray, summarised
from dirl.reporting.tables import read_columns
from dirl.runs.checkpoints import CONFIG_FILE, RunError, Summary, is_finished, load_checkpoint
from dirl.scenes.io.files import atomic_path, read_text, write_text
from dirl.scenes.palette import SYSTEM_COLORS
from dirl.training.build import Trained, load_trained

K = TypeVar("K")

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
    summary: Summary

    @property
    def total(self) -> int:
        """The number of frames of its training."""
        return int(self.summary["frames"])

    @property
    def scenes(self) -> list[str]:
        """The names of the scenes it was made in."""
        names = self.summary["scene"]
        return [names] if isinstance(names, str) else names

    def load(self, changes: Mapping[str, object] | None = None) -> Trained:
        """Load its policy with the final weights; ``changes`` are options to replace, by dotted name."""
        return load_trained(load_checkpoint(self.folder), str(self.folder), changes)

    def table(self, stage: str, *names: str) -> dict[str, FloatArray]:
        """Read columns of ``<stage>.csv``, see `dirl.reporting.tables.read_columns`."""
        return read_columns(self.folder / f"{stage}.csv", *names)


def finished_runs(folder: Path, hint: str) -> list[Result]:
    """Return the finished runs right in a folder, by name; print the names of unfinished ones.

    Raises:
        RunError: there is none; ``hint`` says how to make them.
    """
    finished, unfinished = list[Result](), list[str]()
    for file in sorted(folder.glob(f"*/{CONFIG_FILE}")):
        if is_finished(file.parent):
            summary = json.loads(read_text(file.with_name("summary.json")))
            finished.append(Result(file.parent, read_config(read_text(file), origin=str(file)), summary))
        else:
            unfinished.append(file.parent.name)
    if not finished:
        raise RunError(f"{folder}: holds no finished run; make some by: {hint}")
    if unfinished:
        print(f"not finished, left out: {', '.join(unfinished)}")
    # Of a collection, experiments compare runs that have more rooms with runs that have fewer.
    scenes = {str(run.config.scene if run.config.split else run.summary["scene"]) for run in finished}
    if len(scenes) > 1:
        raise RunError(f"{folder}: holds runs of different scenes, {' and '.join(sorted(scenes))}; report them apart")
    return finished


def grouped(results: Sequence[Result], key: Callable[[TrainConfig], K]) -> dict[K, list[Result]]:
    """Group runs by a function of their configuration, in their order."""
    groups: dict[K, list[Result]] = {}
    for result in results:
        groups.setdefault(key(result.config), []).append(result)
    return groups


def by_system(results: Sequence[Result]) -> dict[str, list[Result]]:
    """Group runs by system, in the order of `NAMES`."""
    groups = grouped(results, lambda config: config.system)
    return {name: groups[name] for name in [*NAMES, *sorted(set(groups) - set(NAMES))] if name in groups}


def published(experiment: str) -> Summary:
    """Return the paper's numbers, and under ``source`` their place in it."""
    text = (Path(__file__).parent / "published.toml").read_text()
    return tomllib.loads(text)[experiment]


Cell = str | float | list[float] | None
"""A cell of a `Table`: a text, a number, numbers of all runs, or nothing."""


class Table:
    """Rows of texts, numbers, and lists of numbers: one for each run, shown as interquartile mean and interval.

    Columns are given by heading, with the format of their numbers, as for `format`; an empty one for texts.
    """

    def __init__(self, columns: Mapping[str, str]) -> None:
        self.columns = dict(columns)
        self.rows: list[tuple[Cell, ...]] = []

    def add(self, *cells: Cell) -> None:
        """Add a row; None stays empty."""
        assert len(cells) == len(self.columns)
        self.rows.append(cells)

    def markdown(self) -> str:
        """Return the table as Markdown."""
        forms = list(self.columns.values())
        lines = [list(self.columns), ["--:" if form else ":--" for form in forms]]
        lines += [[_text(*cell) for cell in zip(row, forms, strict=True)] for row in self.rows]
        return "\n".join(f"| {' | '.join(line)} |" for line in lines)

    def write_csv(self, file: Path) -> None:
        """Write rows for each run: rows without lists once, else one for each place in the lists, numbered ``run``."""
        with atomic_path(file) as temporary, temporary.open("w", newline="") as stream:
            writer = csv.writer(stream)
            writer.writerow([*self.columns, "run"])
            for row in self.rows:
                for run in range(max((len(cell) for cell in row if isinstance(cell, list)), default=1)):
                    writer.writerow([*(cell[run] if isinstance(cell, list) else cell for cell in row), run])


def _text(cell: Cell, form: str) -> str:
    if cell is None:
        return ""
    if isinstance(cell, list):
        return summarised(cell, form)
    return str(cell) if isinstance(cell, str) else format(cell, form)


def write_tables(out: Path, title: str, note: str, tables: Mapping[str, Table], figures: Mapping[str, str]) -> str:
    """Write ``<name>.csv`` for each table, and ``README.md`` with all of them and the figures; returns its text.

    Of figures it is given what each shows, for readers who do not see it.
    """
    out.mkdir(parents=True, exist_ok=True)
    parts = [f"# {title}", note]
    for name, table in tables.items():
        table.write_csv(out / f"{name}.csv")
        parts.append(table.markdown())
    parts += [f"![{shown}]({name}.png)" for name, shown in figures.items()]
    text = "\n\n".join(parts) + "\n"
    write_text(out / "README.md", text)
    return text
