"""Results as Markdown tables that also read well in a terminal."""

import csv
import math
import textwrap
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dirl.config.folders import command
from dirl.reporting.statistics import mean_interval
from dirl.runs.checkpoints import Summary
from dirl.scenes.io.files import atomic_path, read_text

# Heading, key in `dirl.evaluation.metrics`, decimals. With labels of 13 characters a table has 80 columns.
MEASURES = (
    ("ATL", "atl", 2),
    ("SR", "sr", 3),
    ("SPL", "spl", 3),
    ("shortest", "shortest", 2),
    ("false", "false_stop_rate", 3),
    ("missed", "missed_stop_rate", 3),
    ("episodes", "episodes", 0),
)
"""Three decimals of rates, so that one of 0.998 is not printed as 1. "false" and "missed" are of stops."""

COLUMNS = 80
"""Of a terminal."""

GOAL_COLUMNS = {
    "scene": "name",
    "goal": "state",
    "episodes": "number",
    "sr": "success rate",
    "spl": "success weighted by shortest path / steps",
    "atl": "mean steps, a failure counts the limit",
    "atl_success": "mean steps of successes",
    "shortest": "mean steps of shortest paths",
    "false_stop_rate": "fraction that stopped elsewhere",
    "missed_stop_rate": "fraction that passed the goal unnoticed",
}
"""Of the table that `write_goals` writes, and what they mean."""

SECTIONS = {
    "shortest path": "shortest_path",
    "random": "random",
    "sweep, ignores the goal": "sweep",
    "led to another goal": "another_goal",
    "greedy": "greedy",
    "sampled": "sampled",
    "live": "live",
    "live, told": "live_told",
}

NAMED_SCENES = 4
"""Of so many scenes a title gives all names."""

MOST_GOALS = 40
"""Rows of the table by goal; of more goals only ``summary.json`` has the measures of each."""

MANY_FALSE_STOPS = 0.5
"""Of the greedy episodes, above which there is a hint."""


def result_table(rows: Mapping[str, Mapping[str, float | None]], leave_out: Collection[str] = ()) -> str:
    """Return a Markdown table with a line for each row and a column for each measure.

    Args:
        rows: measures by row label, see `dirl.evaluation.metrics`. One that is missing, None or NaN is printed as
            "-"; keys that are no measures are left out.
        leave_out: headings of `MEASURES`.

    Returns:
        A Markdown table without a line break at its end.
    """
    shown = [measure for measure in MEASURES if measure[0] not in leave_out]
    known = {key for _, key, _ in MEASURES} | {"atl_success"}
    own = dict.fromkeys(key for row in rows.values() for key, value in row.items() if isinstance(value, float))
    shown += [(key, key, 3) for key in own if key not in known]  # of a user's own metric
    cells = [["", *(heading for heading, _, _ in shown)]]
    for label, measures in rows.items():
        cells.append([label.replace("|", r"\|")])
        for _, key, decimals in shown:
            value = measures.get(key)
            if value is None or math.isnan(value):
                cells[-1].append("-")
            else:  # five digits at most: 6.19 keeps two decimals, and 153.25 becomes 153.3
                cells[-1].append(f"{value:,.{decimals if value < 100 or not decimals else 1}f}")
    # A column is never narrower than the "--:" under its heading.
    widths = [max(3, *map(len, column)) for column in zip(*cells, strict=True)]
    rule = ["-" * widths[0], *("-" * (width - 1) + ":" for width in widths[1:])]
    lines = [
        [row[0].ljust(widths[0]), *(cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True))]
        for row in [cells[0], rule, *cells[1:]]
    ]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def summary_table(summary: Summary) -> str:
    """Return a run's ``summary.json`` as text.

    Args:
        summary: ``scene``, ``source``, ``system``, ``seed`` and ``frames``; ``frames_per_second``, ``seconds``,
            ``stable_at_frame`` (None: never) and ``peak_memory_mb`` are printed if they are present.
            ``shortest_path``, ``random``, ``greedy`` and ``sampled`` hold measures, those that were evaluated;
            ``greedy`` also those of each scene and goal, as `dirl.evaluation.protocol.report` gives them.

    Returns:
        A heading line, the table of the policies, that of held-out goals if there are any, that of the greedy policy
        by scene and goal, or by scene, if it has at most `MOST_GOALS` rows, among several scenes `over_scenes`, and a
        hint if false stops end most of them. Markdown.
    """
    facts = [] if "agent" in summary else [f"{summary['frames']:,} frames"]
    if (rate := summary.get("frames_per_second")) is not None:
        facts.append(f"{rate:,.0f} frames/s")
    if (seconds := summary.get("seconds")) is not None:
        minutes = round(seconds / 60)
        longer = f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"
        facts.append(f"{longer if seconds >= 120 else f'{seconds:.1f} s'} in all")
    if "stable_at_frame" in summary:
        stable = summary["stable_at_frame"]
        facts.append("never stable" if stable is None else f"stable at {stable:,} frames")
    if (memory := summary.get("peak_memory_mb")) is not None:
        facts.append(f"peak memory {memory:,.0f} MB")
    text = ": ".join([run_title(summary), *([", ".join(facts)] if facts else [])])
    parts = [textwrap.fill(text, COLUMNS, break_long_words=False, break_on_hyphens=False)]
    parts.append(result_table({label: summary[key] for label, key in SECTIONS.items() if summary.get(key)}))
    if held_out := summary.get("held_out"):
        rows = {label: held_out[key] for label, key in SECTIONS.items() if held_out.get(key)}
        parts += ["Goals held out of the training:", result_table(rows)]
    scenes = (summary.get("greedy") or {}).get("scenes", {})
    several = len(scenes) > 1
    if several:
        parts.append(textwrap.fill(over_scenes(scenes), COLUMNS, break_on_hyphens=False))
    # A row for each goal; among several scenes also one for each scene, before its goals.
    listed: dict[str, Mapping[str, float | None]] = {}
    for name, measures in scenes.items():
        listed |= {name: measures} if several else {}
        prefix = f"{name}, " if several else ""
        listed |= {f"{prefix}goal {goal}": of_goal for goal, of_goal in measures["goals"].items()}
    if 0 < len(listed) <= MOST_GOALS:
        parts += ["Greedy policy by goal:", result_table(listed, leave_out=["episodes"])]
    elif several and len(scenes) <= MOST_GOALS:
        parts += ["Greedy policy by scene:", result_table(scenes)]
    false = (summary.get("greedy") or {}).get("false_stop_rate", 0.0)
    if false > MANY_FALSE_STOPS:  # an encoder of one's own, whose features have a large mean in common
        hint = (
            f"False stops ended {false:.0%} of the greedy episodes: to matching, other places look like the goal. "
            f"Raise the threshold ({command('scenes')} inspect scene=... says how far), or subtract the features' mean."
        )
        parts.append(textwrap.fill(hint, COLUMNS))
    return "\n\n".join(parts)


def over_scenes(scenes: Mapping[str, Mapping[str, float]]) -> str:
    """Return a sentence: the mean SPL of all episodes, its interval over scenes, and the worst scene.

    Of the measures by scene ``spl``, ``sr`` and ``episodes`` are read.
    """
    spl, episodes = (np.array([of[name] for of in scenes.values()], float) for name in ("spl", "episodes"))
    low, high = mean_interval(spl, episodes)
    worst = min(scenes, key=lambda name: scenes[name]["spl"])
    return (
        f"SPL of the greedy policy in {len(scenes)} scenes: {np.average(spl, weights=episodes):.3f}, 95% interval "
        f"{low:.3f} to {high:.3f} (bootstrap over scenes). Worst scene: {worst}, SPL {scenes[worst]['spl']:.3f}, "
        f"SR {scenes[worst]['sr']:.3f}."
    )


def run_title(summary: Summary) -> str:
    """Return the system, scenes and seed of a run: "DIRL, bathroom_02 (source: rooms, synthetic), seed 0"."""
    scenes = scene_names(summary["scene"])
    # The built-in rooms have the names of published scenes; their results must not be confused with those.
    sources = ["rooms, synthetic" if source == "rooms" else source for source in summary["source"].split("+")]
    system = summary["system"].upper().replace("_", "-")
    if "agent" in summary:  # one of the package, as it came
        return f"{summary['agent']}, {scenes} (source: {' + '.join(sources)})"
    return f"{system}, {scenes} (source: {' + '.join(sources)}), seed {summary['seed']}"


def scene_names(scene: str | Sequence[str]) -> str:
    """Return the names of scenes; of many their number, the first and the last."""
    names = [scene] if isinstance(scene, str) else list(scene)
    return ", ".join(names) if len(names) <= NAMED_SCENES else f"{len(names)} scenes, {names[0]} to {names[-1]}"


def read_columns(file: Path, *names: str) -> dict[str, NDArray[np.float64]]:
    """Return some columns of a CSV file; an empty cell is NaN. A stage that never ran has no file, so no rows.

    Raises:
        ValueError: it is no table, see also `dirl.scenes.io.files.read_text`.
    """
    try:
        rows = list(csv.DictReader(read_text(file).splitlines(), strict=True)) if file.is_file() else []
    except csv.Error as error:
        raise ValueError(f"{file}: is no table ({error})") from None
    return {name: np.array([float(row[name] or "nan") for row in rows], float) for name in names}


def write_goals(measures: Summary, file: Path) -> None:
    """Write the measures of each goal, a row a goal, as `dirl.evaluation.protocol.report` gives them, as CSV."""
    with atomic_path(file) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, list(GOAL_COLUMNS), extrasaction="ignore")
        writer.writeheader()
        for scene, measured in measures["scenes"].items():
            for goal, of in measured["goals"].items():
                shown = {name: f"{value:.6g}" if isinstance(value, float) else value for name, value in of.items()}
                writer.writerow({"scene": scene, "goal": goal, **shown})
