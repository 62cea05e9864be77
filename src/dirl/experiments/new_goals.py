"""Figures 5 and 6: goals that were not trained (paper section 4.5.3)."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

from dirl.evaluation.protocol import metrics
from dirl.experiments.results import COLOR_OF, NAMES, Result, Table, by_system, published, write_tables
from dirl.reporting import draw_trajectories, run_title, write_gif
from dirl.reporting.statistics import bootstrap_interval, iqm
from dirl.reporting.style import panels, save_figure
from dirl.runs.checkpoints import RunError
from dirl.scenes import Scene
from dirl.scenes.goals import well_reached
from dirl.scenes.world import World
from dirl.training.build import build_goals

DISTANCES = (1, 2, 4, 8)
"""Steps from a new goal to the nearest trained one."""

PER_SCENE = 2
"""New goals of each distance; with four scenes the paper's eight."""

MAX_STEPS = 500
"""An episode that has not arrived by then has failed."""

SYSTEMS = ("dirl", "td_drl", "a3c")
"""Systems that are compared; in figure 5 also ``dirl_compared`` and ``any_goal``, at goals that they were not shown."""


def new_goals(world: World, distance: int, among: Mapping[str, Sequence[int]] | None = None) -> dict[str, list[int]]:
    """Return goals so many steps, turns among them, from the nearest trained one, by scene, as states of it.

    Up to `PER_SCENE` of each scene, drawn from the states in ``among``, or from all, that every state with a path to a
    trained goal reaches. A scene without any is left out.
    """
    generator = np.random.default_rng(0)
    chosen = {}
    for index, scene in enumerate(world.scenes):
        trained = world.local_goals(index).tolist()
        to_trained = scene.distances[:, trained]
        nearest = np.where(to_trained < 0, np.iinfo(to_trained.dtype).max, to_trained).min(1)
        fitting = np.flatnonzero((nearest == distance) & well_reached(scene))
        if among is not None:
            fitting = fitting[np.isin(fitting, among[scene.name])]
        picked = generator.choice(fitting, min(PER_SCENE, len(fitting)), replace=False)
        if len(picked):
            chosen[scene.name] = sorted(picked.tolist())
    return chosen


def report_new_goals(results: Sequence[Result], out: Path, note: str, starts: int = 500) -> str:
    """Write figure 5: the success rate for new goals by their distance from trained ones."""
    columns = {"system": "", "runs": "d", "steps from a trained goal": "d", "goals": "d"}
    columns |= {"SR, sampled": ".3f", "SPL, sampled": ".3f", "SR, greedy": ".3f", "shortest": ".2f"}
    table = Table(columns)
    bars: dict[str, dict[int, list[float]]] = {}
    compared = by_system(results)
    # Policies that have hardly learned succeed by chance; the random baseline shows how often.
    compared = {"random": list(compared.values())[-1], **compared}
    total = len(DISTANCES) * sum(map(len, compared.values()))
    with tqdm(total=total, desc="new goals", unit=" runs x distances", disable=None) as bar:
        for system, runs in compared.items():
            worlds = [_of_the_paper(run) for run in runs]
            for distance in DISTANCES:
                measured = []
                for run, (world, among) in zip(runs, worlds, strict=True):
                    chosen = new_goals(world, distance, among)
                    if chosen:
                        measured.append(_measured(run, chosen, starts, by_chance=system == "random"))
                    bar.update()
                if not measured:
                    continue
                sampled, greedy = zip(*measured, strict=True)
                rates, spl = [run["sr"] for run in sampled], [run["spl"] for run in sampled]
                sure = None if system == "random" else [run["sr"] for run in greedy]
                goals, shortest = sum(map(len, chosen.values())), sampled[0]["shortest"]
                table.add(NAMES[system], len(runs), distance, goals, rates, spl, sure, shortest)
                bars.setdefault(NAMES[system], {})[distance] = rates
    _draw_bars(bars, out)
    text = (
        f"{note}\n\n{PER_SCENE} new goals for each scene and distance, {starts} starts each, at most {MAX_STEPS} "
        f"steps; the figure shows sampled policies. Paper: {published('fig5')['source']}."
    )
    shown = "SR of each system at new goals 1, 2, 4 and 8 steps from the nearest trained goal, as bars"
    return write_tables(out, "Figure 5: new goals", text, {"fig5": table}, {"fig5": shown})


def _of_the_paper(run: Result) -> tuple[World, dict[str, tuple[int, ...]] | None]:
    """Return the world with the scenes' own goals; if the run was trained for others too, also those it was not."""
    world = run.load().protocol.world
    if not run.config.hold_out:
        return world, None
    held_out = build_goals(run.config, world.scenes).held_out
    return world.with_goals(None), held_out


def _measured(
    run: Result, chosen: Mapping[str, list[int]], starts: int, *, by_chance: bool
) -> tuple[dict[str, float], dict[str, float]]:
    """Measure a run's policy on its way to new goals, sampled and greedy; or a random walker, twice."""
    changes = {"goals": chosen, "evaluation.starts": "sampled", "evaluation.episodes_per_goal": starts}
    _, policy, protocol = run.load({**changes, "evaluation.max_steps": MAX_STEPS})
    world = protocol.world
    if by_chance:
        walked = [protocol.run_random()] * 2
    else:
        walked = [protocol.run(policy, greedy=greedy) for greedy in (False, True)]
    # The scenes that have no new goal have their trained ones.
    scenes = torch.tensor([world.names.index(name) for name in chosen], device=world.device)
    inside = [episodes.select(torch.isin(world.scene_of[episodes.start], scenes)) for episodes in walked]
    return metrics(inside[0]), metrics(inside[1])


def _draw_bars(bars: Mapping[str, Mapping[int, list[float]]], out: Path) -> None:
    figure, (axes,) = panels(1, (6.5, 3.8))
    axes.grid(visible=False, axis="x")
    width = 0.8 / max(1, len(bars))
    for number, (label, rates) in enumerate(bars.items()):
        for distance, values in rates.items():
            at = DISTANCES.index(distance) + (number - (len(bars) - 1) / 2) * width
            middle, (low, high) = float(iqm(values)), bootstrap_interval(values)
            name = label if distance == min(rates) else None
            axes.bar(at, middle, 0.92 * width, color=COLOR_OF[label], label=name)
            axes.plot([at, at], [low, high], color="black", linewidth=1.2)
    axes.set_xticks(range(len(DISTANCES)), [f"{d} step{'' if d == 1 else 's'}" for d in DISTANCES])
    axes.set(xlabel="from the nearest trained goal", ylabel="SR, sampled policy", ylim=(0, 1.03))
    figure.legend(loc="outside upper center", ncols=4, frameon=False)
    save_figure(figure, out, "fig5")


def report_control(results: Sequence[Result], out: Path, note: str, scene: str, goal: int) -> str:
    """Write figure 6: how each system goes to one new goal from the farthest start, as picture and as GIF.

    Raises:
        RunError: the runs were not made in that scene.
    """
    paper = published("fig6")
    columns = {"system": "", "runs": "d", "steps, paper": "d", "steps": ".0f"}
    columns |= {"steps of every start": ".2f", "SR of every start": ".3f", "shortest": "d"}
    table = Table(columns)
    pictures = {}
    for system, runs in by_system(results).items():
        walked, every = [], []
        for run in runs:
            if scene not in run.scenes:
                raise RunError(f"scene={scene}: the runs are of {', '.join(run.scenes)}; choose one of them")
            changes = {"goals": {scene: [goal]}, "evaluation.max_steps": MAX_STEPS, "evaluation.starts": "every"}
            _, policy, protocol = run.load(changes)
            goal_index, start = protocol.starts
            index = protocol.world.names.index(scene)
            there = goal_index == protocol.world.goals_of[index][0]
            episodes, paths = protocol.trajectories(policy, (goal_index[there], start[there]), greedy=False)
            farthest = int(episodes.shortest.argmax())
            walked.append(episodes.steps[farthest].item())
            every.append(metrics(episodes))
            if run is runs[0]:
                arrived, name = bool(episodes.success[farthest]), f"fig6_{system}"
                pictures[name] = f"The path of {NAMES[system]} from the farthest start on the map, and views along it"
                path = [state - protocol.world.offsets[index] for state in paths[farthest]]
                _draw_walk(protocol.world.scenes[index], run, goal, path, out / name, success=arrived)
        steps, rates = [means["atl"] for means in every], [means["sr"] for means in every]
        shortest = int(episodes.shortest.max())
        table.add(NAMES[system], len(runs), paper.get(system), walked, steps, rates, shortest)
    text = (
        f"{note}\n\nSampled policies on the way to state {goal} of {scene}, which was not trained, from the farthest "
        f"start, at most {MAX_STEPS} steps. Pictures and GIFs are of the first seed. Paper: {paper['source']}."
    )
    return write_tables(out, "Figure 6: the control process", text, {"fig6": table}, pictures)


def _draw_walk(room: Scene, run: Result, goal: int, path: list[int], file: Path, *, success: bool) -> None:
    """Draw the states of an episode; the file's name gets the endings png, svg and gif."""
    ended = f"{len(path) - 1} steps" if success else "failed"
    title = f"{run_title({**run.summary, 'scene': room.name, 'source': room.source})}, new goal {goal}: {ended}"
    for kind in ("png", "svg"):
        draw_trajectories(room, goal, [path], file.with_suffix(f".{kind}"), success=[success], title=title)
    write_gif(room, goal, path, file.with_suffix(".gif"), title=title, success=success)
