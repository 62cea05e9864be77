"""Figures 4, 7 and 8: how many frames it takes until the policy is stable (paper sections 4.5.1 and 4.5.4)."""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.ticker import EngFormatter

from dirl.evaluation.protocol import STABLE_ATL, WINDOW
from dirl.experiments.results import COLOR_OF, NAMES, Result, Table, by_system, grouped, published, write_tables
from dirl.reporting.curves import atl_axis, common_frames
from dirl.reporting.statistics import FloatArray, bootstrap_interval, iqm
from dirl.reporting.style import panels, save_figure
from dirl.runs.checkpoints import Summary
from dirl.scenes.palette import COLORS

RULES = {"random": "drawn states", "interval": "every k-th state", "interval_pos": "every k-th place"}


def stable_frames(result: Result) -> float:
    """Return when the policy became stable, in frames; infinity if it never did."""
    frame = result.summary["stable_at_frame"]
    return math.inf if frame is None else float(frame)


def mean_stable_frames(result: Result) -> float:
    """Return the frame from which the mean over the goals is low enough, a weaker criterion; infinity if never.

    Taken from ``reinforcement.csv``, so it is one of its rows.
    """
    frames, atl = training_curve(result)
    above = np.flatnonzero(atl > STABLE_ATL)
    first = above[-1] + 1 if len(above) else 0
    return float(frames[first]) if first < len(frames) else math.inf


def training_curve(result: Result) -> tuple[FloatArray, FloatArray]:
    """Return frames and training ATL, ``[K]`` each, once there are `WINDOW` episodes a goal.

    The first episodes to end are short ones, so the mean of few episodes is biased.
    """
    rows = result.table("reinforcement", "frames", "atl", "episodes")
    goals = sum(len(scene["goals"]) for scene in result.summary["greedy"]["scenes"].values())
    enough = rows["episodes"] >= WINDOW * goals
    return rows["frames"][enough], rows["atl"][enough]


def report_efficiency(experiment: str, results: Sequence[Result], out: Path, note: str) -> str:
    """Write the curves and the table of frames for figure 4, 7 or 8."""
    paper = published(experiment)
    titles = {"fig4": "sample efficiency", "fig7": "surrounding or sequential views", "fig8": "the expert's fraction"}
    columns = {"setting": "", "runs": "d", "frames, paper": ",d", "frames, every goal": ",.0f"}
    table = Table({**columns, "frames, mean of goals": ",.0f", "ATL at the end": ".2f", "trained": ",d"})
    drawn = {}
    for label, runs, reported, is_drawn in _settings(experiment, results, paper):
        table.add(
            label,
            len(runs),
            reported,
            [stable_frames(run) for run in runs],
            [mean_stable_frames(run) for run in runs],
            [run.summary["greedy"]["atl"] for run in runs],
            max(run.total for run in runs),
        )
        if is_drawn:
            drawn[label] = runs
    draw_efficiency(drawn, out, experiment)
    text = (
        f"{note}\n\nFrames until the mean steps of the last {WINDOW} training episodes stay at or under a limit: "
        f"{STABLE_ATL:g} for every goal; {STABLE_ATL:g} in the mean over the goals. Paper: {paper['source']}."
    )
    title = f"Figure {experiment[3]}: {titles[experiment]}"
    shown = "Training ATL over frames for each setting, with the limit under which it is stable"
    return write_tables(out, title, text, {experiment: table}, {experiment: shown})


def _settings(
    experiment: str, results: Sequence[Result], paper: Summary
) -> Iterator[tuple[str, list[Result], float | None, bool]]:
    """Yield each setting's label, its runs, the frames that the paper reports or None, and whether it is drawn."""
    if experiment == "fig4":
        for system, runs in by_system(results).items():
            if system in ("dirl", "td_drl", "a3c", "dirl_ppo", "dirl_compared"):
                yield NAMES[system], runs, paper.get(system), True
        return
    if experiment == "fig7":
        for kind, runs in grouped(results, lambda config: config.observation["_target_"]).items():
            views = kind.rpartition(".")[2].removesuffix("Views").lower()  # surrounding or sequential
            yield f"{views} views", runs, paper[views], True
        return
    settings = grouped(results, lambda config: (config.imitation.fraction, str(config.imitation.rule)))
    # The paper's rule is `interval`; what learns best is drawn.
    main = "random" if any(rule == "random" and share for share, rule in settings) else "interval"
    for (share, rule), runs in sorted(settings.items(), key=lambda item: (list(RULES).index(item[0][1]), item[0][0])):
        label = f"{share:.0%}, {RULES[rule]}" if share else "no expert"
        reported = paper.get(str(float(share))) if rule in ("interval", main) or not share else None
        yield label, runs, reported, rule == main or not share


def draw_efficiency(groups: Mapping[str, Sequence[Result]], out: Path, name: str) -> None:
    """Draw training ATL over frames, the interquartile mean of each group with its 95 % interval."""
    figure, (axes,) = panels(1, (8, 4.6))
    for other, (label, runs) in zip(COLORS, groups.items(), strict=False):
        color = COLOR_OF.get(label, other)  # groups that are no systems are settings of one
        frames, values = common_frames([training_curve(run) for run in runs])
        if not len(frames):
            axes.plot([], [], color=color, label=f"{label}: never stable, too few episodes to draw")
            continue
        stable = float(iqm([stable_frames(run) for run in runs]))
        when = f"stable at {stable:,.0f}" if np.isfinite(stable) else "never stable"
        axes.fill_between(frames, *bootstrap_interval(values), color=color, alpha=0.2, linewidth=0)
        axes.plot(frames, iqm(values), color=color, label=f"{label}: {when}", linewidth=1.6)
        if np.isfinite(stable):
            axes.axvline(stable, color=color, linestyle=":", linewidth=1.2)
    limit = f"stable: every goal stays at or under {STABLE_ATL:g}"
    axes.axhline(STABLE_ATL, color="0.3", linestyle="--", linewidth=1, label=limit)
    atl_axis(axes, f"training ATL (steps, log scale),\nlast {WINDOW} episodes of each goal")
    axes.set_xlabel("frames")
    axes.xaxis.set_major_formatter(EngFormatter())
    figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    save_figure(figure, out, name)
