"""The results of a sweep, as a table at its end."""

import json
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig

from dirl.config.saved import plain_mapping
from dirl.config.values import leaves
from dirl.reporting.seeds import FEW, draw_seeds, seed_table
from dirl.reporting.tables import result_table
from dirl.scenes.io.bounded import read_text


class SweepTable(Callback):
    """Prints a table of the runs of a sweep when its jobs are done: Hydra's ``on_multirun_end``."""

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Print it; a run that failed has no summary, and no row."""
        swept = config.hydra
        given = [override.partition("=")[0].lstrip("+~") for override in swept.overrides.task]
        table = sweep_table(Path(swept.sweep.dir), {*given, *(swept.sweeper.get("params") or {})})
        if table:
            print(f"\nGreedy policies of {swept.sweep.dir}:\n\n{table}")
        told_of_seeds(Path(swept.sweep.dir))


def told_of_seeds(folder: Path) -> None:
    """Print and draw the spread of a sweep's runs if they differ in their seed only."""
    files = [file for file in sorted(folder.glob("**/summary.json")) if file.with_name("config.yaml").is_file()]
    configs = [leaves(plain_mapping(read_text(file.with_name("config.yaml")))) for file in files]
    differing = {name for config in configs for name in config if config.get(name) != configs[0].get(name)}
    if len(files) >= FEW and differing == {"seed"}:
        summaries = [json.loads(read_text(file)) for file in files]
        draw_seeds(summaries, folder / "seeds.png")
        print(f"\nOver the seeds (picture: {folder / 'seeds.png'}):\n\n{seed_table(summaries)}")


def sweep_table(folder: Path, options: Collection[str]) -> str:
    """The greedy measures of the finished runs in a sweep's folder, Markdown; empty where there are fewer than two.

    Of the options that were given, by name, those that differ between the runs tell them apart.
    """
    runs: dict[Path, dict[str, Any]] = {}
    measures: dict[Path, Mapping[str, Any]] = {}
    for file in sorted(folder.glob("**/summary.json"), key=lambda file: (len(file.parent.name), str(file))):
        summary = json.loads(read_text(file))
        config = file.with_name("config.yaml")
        if config.is_file() and "greedy" in summary:
            runs[file.parent] = leaves(plain_mapping(read_text(config)))
            measures[file.parent] = summary["greedy"]
    if len(runs) < 2:
        return ""
    inside = tuple(f"{option}." for option in options)
    given = {name for config in runs.values() for name in config if f"{name}.".startswith(inside)}
    told = [name for name in sorted(given) if len({str(config.get(name)) for config in runs.values()}) > 1]
    rows = {}
    for run, found in runs.items():
        label = ", ".join(_told(name, found.get(name)) for name in told)
        rows[f"{run.relative_to(folder)}: {label}" if label else str(run.relative_to(folder))] = measures[run]
    return result_table(rows, leave_out=["false", "missed", "episodes"])


def _told(name: str, value: Any) -> str:
    """An option and its value in few letters: its last name, of a component its group and class."""
    group, _, last = name.rpartition(".")
    return f"{group}={str(value).rpartition('.')[2]}" if last == "_target_" else f"{last}={value}"
