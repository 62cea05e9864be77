"""Section 4.5.4: stopping by template matching in disturbed views, which the paper does not measure."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image, ImageEnhance, ImageFilter
from tensordict import TensorDictBase
from torch import Tensor, nn

from dirl.evaluation.protocol import metrics
from dirl.experiments.figures import save_figure
from dirl.experiments.measures import decimals
from dirl.experiments.results import Result, Table, published, write_tables
from dirl.models import FeatureTable
from dirl.models.build import build_policy, load_weights
from dirl.perception.backbones import ViewEncoder, encode_all
from dirl.perception.recognition.matching import ncc, template_vectors
from dirl.reporting.style import plain, tell_cut
from dirl.runs.paths import RunError
from dirl.scenes import Scene
from dirl.scenes.palette import BLUE, GREEN, PURPLE, VERMILION
from dirl.training.build import Trained

DISTURBANCES: Mapping[str, tuple[str, tuple[float, ...]]] = {
    "noise": ("deviation, grey levels", (8, 16, 32, 64)),
    "darkness": ("share of light lost", (0.2, 0.4, 0.6, 0.8)),
    "blur": ("radius, pixels", (1, 2, 4, 8)),
    "occlusion": ("share of the view", (0.05, 0.1, 0.2, 0.4)),
}
"""What is done to views: the unit of its strength, and growing strengths."""

THRESHOLDS = np.arange(0.30, 1.0, 0.01)

MEASURED = ("precision", "recall", "SR", "false stops")

PRECISION = 0.99
"""Of a recommended threshold: a false stop ends an episode, a missed one costs steps."""

SAME = 0.85
"""Least correlation of features computed anew with the stored ones; other compression moves them a little."""

ByteArray = NDArray[np.uint8]


def disturb(view: ByteArray, kind: str, strength: float, generator: np.random.Generator) -> ByteArray:
    """A view, uint8 ``[H, W, 3]``, with one of the `DISTURBANCES`; occlusion is a grey square at a random place."""
    if kind == "noise":
        return (view + generator.normal(0, strength, view.shape)).clip(0, 255).astype(np.uint8)
    image = Image.fromarray(view)
    if kind == "darkness":
        return np.asarray(ImageEnhance.Brightness(image).enhance(1 - strength))
    if kind == "blur":
        return np.asarray(image.filter(ImageFilter.GaussianBlur(strength)))
    height, width = view.shape[:2]
    side = round((strength * height * width) ** 0.5)
    top, left = (int(generator.integers(max(1, length - side + 1))) for length in (height, width))
    covered = view.copy()
    covered[top : top + side, left : left + side] = 128
    return covered


def encode_disturbed(scene: Scene, encoder: ViewEncoder, kind: str | None = None, strength: float = 0.0) -> Tensor:
    """Features of a scene's views, float32 ``[N, D]``, disturbed if a kind is given; always the same way."""
    assert scene.views is not None
    generator, views = np.random.default_rng(0), scene.views
    seen = (
        views[state] if kind is None else disturb(views[state], kind, strength, generator)
        for state in range(len(scene))
    )
    return torch.from_numpy(encode_all(encoder, seen, len(scene), scene.origin).features)


def coefficients(clean: Tensor, disturbed: Tensor, scene: Scene, match: str) -> tuple[Tensor, Tensor]:
    """The matching coefficient of disturbed views with clean goals, with every state of the scene as the goal.

    Returns:
        At the goal, float ``[N]``; elsewhere, float ``[N * (N - 1)]``.
    """
    surrounding = torch.tensor(scene.surrounding)
    goals, seen = (template_vectors(features, surrounding, match) for features in (clean, disturbed))
    scores = goals @ seen.T
    away = ~torch.eye(len(scores), dtype=torch.bool)
    return scores.diagonal(), scores[away]


def precision_recall(at_goal: Tensor, away: Tensor) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Of stopping above each of `THRESHOLDS`, ``[T]`` each; the precision of no stop at all is one.

    An agent that stands in each state once, with each goal.
    """
    right, wrong = (np.sort(values.numpy()) for values in (at_goal, away))
    hits, errors = (len(values) - np.searchsorted(values, THRESHOLDS, side="right") for values in (right, wrong))
    return np.where(hits + errors, hits / np.maximum(1, hits + errors), 1.0), hits / len(right)


def recommended_threshold(curves: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]]) -> float:
    """The lowest of `THRESHOLDS` from which on the precision is at least `PRECISION` under every disturbance.

    Recall only falls with the threshold. (The best F1 would give up precision with clean views, where the agent mostly
    is, for recall with badly disturbed ones, where it is lost anyway.)
    """
    unsafe = np.flatnonzero(np.min([precision for precision, _ in curves], 0) < PRECISION)
    first = unsafe[-1] + 1 if len(unsafe) else 0
    return float(THRESHOLDS[min(first, len(THRESHOLDS) - 1)].round(2))


class SeesDisturbed(nn.Module):
    """A policy on a table of twice the ``states``: goals are in the first half, what is observed in the second."""

    def __init__(self, policy: Any, states: int) -> None:
        super().__init__()
        self.policy, self.cached, self.states = policy, policy.cached, states

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """As the policy."""
        return self.policy(tensordict.set("view_ids", tensordict["view_ids"] + self.states))


def success(trained: Trained, scene: Scene, clean: Tensor, disturbed: Tensor, threshold: float) -> dict[str, float]:
    """Measures of greedy episodes in a scene; the agent sees disturbed views, and knows its goals by clean ones.

    ``clean`` and ``disturbed`` are features, float32 ``[N, D]``; ``threshold`` is of the stop by template matching.
    """
    config, protocol = trained.config, trained.protocol
    trained_policy: Any = trained.policy
    world, match = protocol.world, config.stop.match
    offset = world.offsets[world.names.index(scene.name)]
    known, seen = world.features.clone(), world.features.clone()
    known[offset : offset + len(scene)], seen[offset : offset + len(scene)] = clean, disturbed
    mean, std = trained_policy.features.mean, trained_policy.features.std
    policy: Any = build_policy(config, FeatureTable(torch.cat([known, seen]), mean, std), world.names)
    load_weights(policy, trained_policy.state_dict(), "the run")
    policy.cache(None)
    goal_index, state = world.pairs()
    goals = template_vectors(known, world.surrounding, match)[world.goals]
    scores = (goals @ template_vectors(seen, world.surrounding, match).T)[goal_index, state]
    goal_index, start = protocol.starts
    inside = world.scene_of[start] == world.names.index(scene.name)
    stop = (scores > threshold) & (world.distances >= 0)
    conditions = replace(protocol, starts=(goal_index[inside], start[inside]), stop=stop, memory=None)
    return metrics(conditions.run(SeesDisturbed(policy, len(world))))


def report_stopping(results: Sequence[Result], out: Path, note: str, scene_name: str, encoder: ViewEncoder) -> str:
    """Write coefficients, precision and recall, and success under disturbed views.

    Raises:
        RunError: the runs were not made in that scene, it has no views, or its features are of another encoder.
    """
    runs = [run.load({"evaluation.starts": "every"}) for run in results]
    world = runs[0].protocol.world
    if scene_name not in world.names:
        raise RunError(f"scene={scene_name}: the runs are of {', '.join(world.names)}; choose one of them")
    scene = world.scenes[world.names.index(scene_name)]
    if scene.views is None:
        raise RunError(f"{scene.origin}: has no views to disturb")
    clean = encode_disturbed(scene, encoder)
    stored = torch.tensor(scene.features).float()
    if clean.shape != stored.shape or ncc(clean, stored).mean() < SAME:
        raise RunError(f"encoder: gives other features than those of {scene.name}, '{scene.extractor}'; name the same")
    match = runs[0].config.stop.match
    found: dict[tuple[str, float], Tensor] = {("none", 0.0): clean}
    for kind, (_, strengths) in DISTURBANCES.items():
        found |= {(kind, strength): encode_disturbed(scene, encoder, kind, strength) for strength in strengths}
    pairs = {key: coefficients(clean, features, scene, match) for key, features in found.items()}
    curves = {key: precision_recall(*pair) for key, pair in pairs.items()}
    best = recommended_threshold(list(curves.values()))
    paper = published("stop")
    limits = dict.fromkeys((paper["threshold"], best))
    columns = {"disturbance": "", "strength": "g"}
    columns |= decimals(["at the goal, mean", "lowest", "elsewhere, 99 %", "highest"])
    table = Table(columns | decimals(f"{what} at {limit:g}" for limit in limits for what in MEASURED))
    for key, features in found.items():
        at_goal, away = pairs[key]
        cells: list[Any] = [*key, float(at_goal.mean()), float(at_goal.min())]
        cells += [float(np.quantile(away.numpy(), 0.99)), float(away.max())]
        for limit in limits:
            place = int(np.abs(THRESHOLDS - limit).argmin())
            cells += [float(values[place]) for values in curves[key]]
            walked = [success(one, scene, clean, features, limit) for one in runs]
            cells += [[one[name] for one in walked] for name in ("sr", "false_stop_rate")]
        table.add(*cells)
    _draw(pairs, paper["threshold"], best, out)
    units = "; ".join(f"{kind}: {unit}" for kind, (unit, _) in DISTURBANCES.items())
    text = (
        f"{note}\n\n{scene_name}, {len(scene)} states, each of them once as the goal for coefficients, precision and "
        f"recall; SR and false stops are of greedy episodes from every start to the trained goals, in which the "
        f"policy, too, sees disturbed views. The goals' views are clean. Strengths are in {units}. "
        f"Paper: {paper['source']}.\n\n"
        f"**Recommended threshold: {best:g}**, the lowest with a precision of {PRECISION:g} under every disturbance."
    )
    shown = (
        "Matching coefficients at the goal and elsewhere by strength of a disturbance, and precision and recall over "
        "the threshold"
    )
    return write_tables(out, "Stopping under disturbed views", text, {"stop": table}, {"stop": shown})


def _draw(pairs: Mapping[tuple[str, float], tuple[Tensor, Tensor]], used: float, best: float, out: Path) -> None:
    """Above the coefficients by strength, below precision and recall over thresholds; a column a disturbance."""
    figure = Figure(figsize=(11, 5.5), layout="constrained")
    grid = figure.subplots(2, len(DISTURBANCES), sharey="row")
    for axes in grid.flat:
        plain(axes)
    for (upper, lower), (kind, (unit, strengths)) in zip(grid.T, DISTURBANCES.items(), strict=True):
        keys = [("none", 0.0), *((kind, strength) for strength in strengths)]
        at = range(len(keys))
        for part, color, label in ((0, BLUE, "at the goal"), (1, VERMILION, "elsewhere")):
            ranges = np.array([np.quantile(pairs[key][part].numpy(), [0.01, 0.5, 0.99]) for key in keys])
            upper.fill_between(at, ranges[:, 0], ranges[:, 2], color=color, alpha=0.2, linewidth=0)
            upper.plot(at, ranges[:, 1], "o-", color=color, markersize=3.5, label=f"{label}, median and 98 %")
        upper.axhline(used, color="0.3", linestyle="--", linewidth=1, label=f"the paper's threshold, {used:g}")
        upper.axhline(best, color="0.3", linestyle=":", linewidth=1.5, label=f"recommended, {best:g}")
        upper.set_xticks(at, [f"{key[1]:g}" for key in keys])
        upper.set(title=kind, xlabel=unit, ylim=(-0.05, 1.05))
        for number, key in enumerate(keys):
            weight = 0.35 + 0.65 * number / (len(keys) - 1)
            for curve, color in zip(precision_recall(*pairs[key]), (PURPLE, GREEN), strict=True):
                lower.plot(THRESHOLDS, curve, color=color, alpha=weight, linewidth=1.3)
        lower.plot([], [], color=PURPLE, label="precision (paler: weaker)")
        lower.plot([], [], color=GREEN, label="recall (paler: weaker)")
        lower.axvline(used, color="0.3", linestyle="--", linewidth=1)
        lower.axvline(best, color="0.3", linestyle=":", linewidth=1.5)
        lower.set(xlabel="threshold", ylim=(-0.05, 1.05))
        tell_cut(lower)
    grid[0, 0].set_ylabel("matching coefficient")
    grid[1, 0].set_ylabel("precision, recall")
    handles = [one for axes in grid[:, 0] for one in axes.get_legend_handles_labels()[0]]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False)
    save_figure(figure, out, "stop")
