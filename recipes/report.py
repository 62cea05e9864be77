"""Write a table or figure of the paper from finished runs, the paper's numbers beside ours.

    python recipes/train.py -m experiment=fig8 && python recipes/report.py experiment=fig8
    python recipes/report.py experiment=table2 preset=paper out=table2_paper

A report is a folder: README.md with the tables, CSV files with the value of every run, figures as PNG and SVG.
All options: `Options` below.
"""

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge

from dirl.cli.start import run, start
from dirl.config.schemas import ExperimentName, Positive, TrainConfig, option


@dataclass
class Options:
    """Write a table or figure of the paper from finished runs."""

    experiment: ExperimentName = option("table1 | table2 | fig4 | fig5 | fig6 | fig7 | fig8")
    runs: str = option("the folder that recipes/train.py -m experiment=... wrote its runs to", "runs/experiments")
    preset: str = option("of the runs", "fast")
    out: str | None = option("a folder for the result; null = reports/<preset>/<experiment>", None)
    scene: str = option("of fig6, which looks at one scene only", "bathroom_02")
    goal: Annotated[int, Ge(0)] = option("the new goal of fig6, a state of the scene", 51)
    starts: Positive = option("of each new goal of fig5", 500)


if __name__ == "__main__":
    options = start(__doc__, Options)  # "loading ...", or help; the imports below take their time

from pathlib import Path

from omegaconf import OmegaConf

from dirl.config.folders import CONF, command
from dirl.experiments.efficiency import report_efficiency
from dirl.experiments.new_goals import SYSTEMS, report_control, report_new_goals
from dirl.experiments.performance import report_performance
from dirl.experiments.results import Result, finished_runs
from dirl.models.build import reads_patches
from dirl.reporting.tables import scene_names
from dirl.runs.checkpoints import RunError


def main(options: Options) -> None:
    """Read the runs, measure what they did not, write the report."""
    out = Path(options.out or f"reports/{options.preset}/{options.experiment}")
    print(write(options, chosen(options), out))
    print(f"report: {out}")


def chosen(options: Options) -> list[Result]:
    """The finished runs that an experiment is about, of all experiments' runs.

    Raises:
        RunError: there is none.
    """
    folder = Path(options.runs) / options.preset
    hint = f"{command('train')} -m experiment={options.experiment} preset={options.preset}"
    usual = OmegaConf.load(CONF / "preset" / f"{options.preset}.yaml").imitation
    runs = finished_runs(folder, hint)
    found = [run for run in runs if belongs(run.config, options.experiment, (usual.fraction, usual.rule))]
    if not found:
        raise RunError(f"no finished run is of experiment={options.experiment}; make some by: {hint}")
    return found


def belongs(config: TrainConfig, experiment: ExperimentName, usual: tuple[float, str]) -> bool:
    """Whether a run is what an experiment is about; ``usual`` is which states the expert shows, and by which rule."""
    shown = config.imitation.fraction, config.imitation.rule
    as_usual = config.system != "dirl" or shown == usual
    match experiment:
        case ExperimentName.fig5 if config.system == "any_goal":
            return config.hold_out > 0 and config.imitation.noise > 0 and reads_patches(config)
        case ExperimentName.fig5 if config.system == "dirl_compared":
            return config.hold_out > 0
        case ExperimentName.fig5 | ExperimentName.fig6:
            return config.system in SYSTEMS and as_usual
        case ExperimentName.fig7:
            return config.system in ("dirl", "td_drl") and config.imitation.fraction == 0
        case ExperimentName.fig8:
            return config.system == "dirl"
    return as_usual


def write(options: Options, runs: list[Result], out: Path) -> str:
    """Write the report of an experiment into a folder; returns its text."""
    name, note = options.experiment, describe_runs(runs)
    out.mkdir(parents=True, exist_ok=True)
    match name:
        case ExperimentName.table1 | ExperimentName.table2:
            return report_performance(name, runs, out, note)
        case ExperimentName.fig4 | ExperimentName.fig7 | ExperimentName.fig8:
            return report_efficiency(name, runs, out, note)
        case ExperimentName.fig5:
            return report_new_goals(runs, out, note, options.starts)
    return report_control(runs, out, note, options.scene, options.goal)


def describe_runs(runs: list[Result]) -> str:
    """What must stand above every table: which rooms, which constants, which seeds, and how numbers are summed up."""
    most = max(runs, key=lambda run: len(run.scenes))
    summary, config = most.summary, most.config
    rooms = "built-in rooms" if config.split is None else "random rooms"
    kind = f"{rooms}, **synthetic, not AI2-THOR**" if summary["source"] == "rooms" else summary["source"]
    seeds = sorted({run.config.seed for run in runs})
    several = "Of several runs: interquartile mean and, in brackets, its 95 % bootstrap interval over seeds."
    told = f"seed {seeds[0]} alone." if len(seeds) == 1 else f"seeds {', '.join(map(str, seeds))}. {several}"
    return f"Scenes: {scene_names(summary['scene'])} ({kind}). Preset `{config.preset}`, {told}"


if __name__ == "__main__":
    run(lambda: main(options), options)
