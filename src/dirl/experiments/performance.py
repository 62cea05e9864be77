"""Tables 1 and 2: how well each system navigates to the goals it was trained for (paper section 4.5.2)."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.lines import Line2D

from dirl.config.schemas import TrainConfig
from dirl.experiments.results import NAMES, Cell, Result, Table, by_system, published, write_tables
from dirl.reporting.statistics import bootstrap_interval, iqm
from dirl.reporting.style import panels, save_figure
from dirl.runs.checkpoints import Summary
from dirl.scenes.palette import SYSTEM_COLORS

MEASURES = {
    "atl": (".2f", "ATL"),
    "atl_success": (".2f", "ATL of successes"),
    "sr": (".3f", "SR"),
    "spl": (".3f", "SPL"),
}


def is_reinforced(config: TrainConfig) -> bool:
    """Return True if a system is trained by reinforcement learning, and so has a half-way."""
    learns = config.policy["_target_"] not in (
        "dirl.evaluation.episodes.RandomPolicy",
        "dirl.evaluation.experts.ShortestPathPolicy",
    )
    return learns and bool(set(config.losses) - {"imitation"})


def halfway(result: Result) -> dict[str, float]:
    """Return the greedy measures after half of the frames; without reinforcement learning those at the end."""
    if not is_reinforced(result.config):
        return measures(result, "greedy")
    rows = result.table("evaluation", "frames", *MEASURES)
    row = int(np.searchsorted(rows["frames"], result.total / 2))
    return {name: float(rows[name][row]) for name in MEASURES}


def measures(result: Result, mode: str) -> dict[str, float]:
    """Return the measures at the end; an ATL of no successes is NaN."""
    summary = result.summary[mode]
    return {name: float("nan") if summary[name] is None else summary[name] for name in MEASURES}


def report_performance(experiment: str, results: Sequence[Result], out: Path, note: str) -> str:
    """Write table 1 (half-way) or 2 (at the end) with the paper's beside ours, and a picture of it."""
    half = experiment == "table1"
    paper = published(experiment)
    columns = {"system": "", "runs": "d", "frames": ",d"}
    for name, (form, heading) in MEASURES.items():
        columns |= {} if name == "atl_success" else {f"{heading}, paper": form}
        columns |= {f"{heading}, ours": form}
    tables = {}
    drawn: dict[str, dict[str, list[float]]] = {}
    for mode in ("greedy",) if half else ("greedy", "sampled"):
        tables[f"{experiment}_{mode}"] = table = Table(columns)
        for system, runs in by_system(results).items():
            measured = [halfway(run) if half else measures(run, mode) for run in runs]
            values = {name: [run[name] for run in measured] for name in MEASURES}
            reported: Summary = paper.get(system, {})
            frames = max(run.total for run in runs) // (2 if half and is_reinforced(runs[0].config) else 1)
            cells: list[Cell] = [NAMES.get(system, system), len(runs), frames]
            for name in MEASURES:
                cells += [values[name]] if name == "atl_success" else [reported.get(name), values[name]]
            table.add(*cells)
            drawn.setdefault(system, values)
    _draw(drawn, paper, out, experiment)
    when = "half-way through" if half else "at the end of"
    title = f"{experiment[:5].capitalize()} {experiment[5]}: trained goals, {when} the training"
    text = f"{note}\n\nPaper: {paper['source']}. Greedy policies" + ("." if half else " first, then sampled ones.")
    shown = f"ATL, SR and SPL of each system {when} the training, here and in the paper"
    return write_tables(out, title, text, tables, {experiment: shown})


def _draw(ours: Mapping[str, Mapping[str, list[float]]], paper: Summary, out: Path, name: str) -> None:
    figure, grid = panels(3, (9, 0.42 * len(ours) + 1.5))
    places = np.arange(len(ours))[::-1]
    for axes, measure in zip(grid, ("atl", "sr", "spl"), strict=True):
        for place, (system, values) in zip(places, ours.items(), strict=True):
            color, interval = SYSTEM_COLORS[system], bootstrap_interval(values[measure])
            axes.plot(interval, [place, place], color=color, linewidth=5, alpha=0.35, solid_capstyle="butt")
            axes.plot(iqm(values[measure]), place, "o", color=color)
            if system in paper:
                axes.plot(paper[system][measure], place, "x", color="0.2", mew=2)
        axes.set_xlabel(MEASURES[measure][1] + (" (steps)" if measure == "atl" else ""))
        axes.set_yticks(places, [NAMES.get(system, system) for system in ours])
        axes.set_xlim(*((0, 208) if measure == "atl" else (-0.04, 1.04)))
    # The legend of the two markers; their colours are those of the systems.
    meanings = {"o": "here, synthetic rooms", "x": "paper, AI2-THOR"}
    handles = [
        Line2D([], [], linestyle="", marker=sign, color="0.2", mew=2, label=text) for sign, text in meanings.items()
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=2, frameon=False)
    save_figure(figure, out, name)
