"""Inspection of a scene before training: its contents, and what in it would mislead an agent or a reader."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from dirl.perception.recognition.recogniser import TemplateStop, in_blocks
from dirl.scenes import Scene, SceneError
from dirl.scenes.graph import AHEAD, BACK, RIGHT, IntArray, places, turns_per_circle

MAX_STATES = 5_000
"""All pairs of states are compared; of a scene with more states that would take gigabytes."""

BLANK = 6.0
"""A view whose grey levels (0 to 255) deviate less than this from their mean shows next to nothing."""

FAR = 2
"""Ambiguous states that are nearer than this many actions are neighbours that only look alike."""


@dataclass(frozen=True, eq=False)
class Inspection:
    """What `inspect_scene` found. N states."""

    facts: dict[str, str]
    """What the scene holds, for a table."""
    problems: list[str]
    """What should be mended, or known: each names the first state, and what to do."""
    parts: IntArray
    """Which part each state is in, int64 ``[N]``, 0 is the largest; within a part every state reaches every other."""
    ambiguous: list[tuple[int, int, float, int]]
    """Pairs of states that match above the threshold: both states, score, actions between them; worst first."""


def inspect_scene(scene: Scene, stop: TemplateStop | None = None) -> Inspection:
    """Check a scene.

    Args:
        scene: N states, at most `MAX_STATES`.
        stop: two states of which one would stop an agent on its way to the other are ambiguous; the paper's if left
            out.

    Raises:
        SceneError: the scene has too many states, or no patches for a recogniser that reads them.
        ValueError: a view cannot be decoded.
    """
    if len(scene) > MAX_STATES:
        raise SceneError(f"{scene.origin}: {len(scene)} states; all pairs are compared, of at most {MAX_STATES}")
    parts = _parts(scene)
    problems = [*_graph_problems(scene, parts), *_map_problems(scene), *_view_problems(scene)]
    stop = stop or TemplateStop()
    ambiguous = []
    if scene.features is None:
        problems.append("there are no features; add them by: scenes.py encode")
    else:
        problems += _feature_problems(scene)
        scores = _scores(scene, stop)
        ambiguous = _ambiguous(scene, scores, stop.threshold)
        problems += _matching_problems(scene, scores, ambiguous, stop.threshold)
    return Inspection(_facts(scene, parts), problems, parts, ambiguous)


def _scores(scene: Scene, stop: TemplateStop) -> NDArray[np.floating]:
    """Return how well every state (row) matches every goal (column), float32 ``[N, N]``."""
    recogniser, surrounding = stop.recogniser, torch.from_numpy(scene.surrounding.copy())
    if recogniser.reads_patches and scene.patches is None:
        raise SceneError(f"{scene.origin}: has no patches, which the recogniser compares; encode it with patches=true")
    assert scene.features is not None
    features = torch.from_numpy(scene.features.astype(np.float32))
    patches = None if scene.patches is None else torch.from_numpy(scene.patches.astype(np.float32))
    fitted = recogniser.fit(features, patches)
    with torch.no_grad():
        visits = fitted.describe(features, patches)[surrounding]
        return in_blocks(fitted, visits, visits[:, :1] if stop.match == "front" else visits).numpy()


def _facts(scene: Scene, parts: IntArray) -> dict[str, str]:
    turns = turns_per_circle(scene.graph)
    reached = scene.distances[scene.distances > 0]
    blocked = (scene.graph[:, [AHEAD, BACK]] < 0).mean()
    sizes = np.bincount(parts)
    width, depth = np.ptp(scene.positions, axis=0) + scene.step_length
    views = "none" if scene.views is None else "x".join(map(str, scene.views[0].shape[:2]))
    features = "none" if scene.features is None else f"{scene.features.shape[1]} {scene.features.dtype}"
    return {
        "name": scene.name,
        "source": scene.source,
        "states": f"{len(scene)}",
        "places": f"{places(scene.graph).max() + 1}",
        "turn": f"{360 / turns:g} degrees",
        "step": f"{scene.step_length:.2f} m",
        "extent": f"{width:.1f} x {depth:.1f} m",
        "parts": f"{len(sizes)}" + (f" (states: {', '.join(map(str, sizes[:8]))})" if len(sizes) > 1 else ""),
        "blocked moves": f"{blocked:.0%}",
        "farthest pair": f"{reached.max()} actions",
        "mean distance": f"{reached.mean():.2f} actions",
        "goals": ", ".join(map(str, scene.goals)) or "none",
        "views": views,
        "features": features,
        "extractor": scene.extractor,
    }


def _parts(scene: Scene) -> IntArray:
    """Return each state's strongly connected part, numbered from the largest on, int64 ``[N]``."""
    both_ways = (scene.distances >= 0) & (scene.distances.T >= 0)
    first = both_ways.argmax(1)
    _, part, sizes = np.unique(first, return_inverse=True, return_counts=True)
    return np.argsort(np.argsort(-sizes, kind="stable"))[part]


def _graph_problems(scene: Scene, parts: IntArray) -> Iterator[str]:
    apart = np.flatnonzero(parts > 0)
    if len(apart):
        state = apart[0]
        x, z = scene.positions[state]
        yield (
            f"state {state} (at x {x:.2f}, z {z:.2f}) and {len(apart) - 1} more are not connected with the largest "
            "part in both directions: give them links, or choose goals and starts within one part"
        )
    lost = [goal for goal in scene.goals if parts[goal] > 0]
    if lost:
        yield f"goal {lost[0]} lies outside the largest part: choose one that most states reach"
    for action, undo, name in ((AHEAD, BACK, "ahead"), (BACK, AHEAD, "back")):
        leads = np.flatnonzero(scene.graph[:, action] >= 0)
        one_way = leads[scene.graph[scene.graph[leads, action], undo] != leads]
        if len(one_way):
            state = one_way[0]
            yield (
                f"state {state}: a move {name} leads to state {scene.graph[state, action]}, and the opposite move does "
                f"not lead back ({len(one_way)} such moves): is a link missing?"
            )


def _map_problems(scene: Scene) -> Iterator[str]:
    turn = 360 / turns_per_circle(scene.graph)
    moving = np.flatnonzero(scene.graph[:, RIGHT] >= 0)
    turned = (scene.headings[scene.graph[moving, RIGHT]] - scene.headings[moving] + 180) % 360 - 180
    sense = -1 if np.median(turned) < 0 else 1  # some files count headings the other way round
    wrong = moving[np.abs(turned - sense * turn) > 1]
    if len(wrong):
        state = wrong[0]
        after = scene.graph[state, RIGHT]
        yield (
            f"state {state}: a turn goes from heading {scene.headings[state]:g} to {scene.headings[after]:g}, but a "
            f"full circle has {360 / turn:g} turns ({len(wrong)} such turns): check rotation, or maps will be wrong"
        )
    leads = np.flatnonzero(scene.graph[:, AHEAD] >= 0)
    moves = scene.positions[scene.graph[leads, AHEAD]] - scene.positions[leads]
    lengths = np.hypot(*moves.T)
    still = leads[lengths < 1e-3]
    if len(still):
        state = still[0]
        yield (
            f"state {state}: a move ahead leads to state {scene.graph[state, AHEAD]} at the same location "
            f"({len(still)} such moves): check location, or the map is wrong"
        )
    with np.errstate(invalid="ignore"):
        aside = (moves * scene.directions[leads]).sum(1) < np.cos(np.deg2rad(45)) * lengths
    if aside.any():
        state = leads[aside][0]
        yield (
            f"state {state}: a move ahead goes more than 45 degrees aside of its heading, {scene.headings[state]:g} "
            f"({aside.sum()} such moves): check rotation and location, or the arrows of the map are wrong"
        )


def _view_problems(scene: Scene) -> Iterator[str]:
    if scene.views is None:
        yield "there are no views; pictures, the viewer and encode need them"
        return
    seen: dict[bytes, int] = {}
    blank, twins, shapes = [], [], set()
    for state in range(len(scene)):
        view = scene.views[state]
        shapes.add(view.shape)
        if view.mean(2).std() < BLANK:
            blank.append(state)
        twin = seen.setdefault(view.tobytes(), state)
        if twin != state:
            twins.append((state, twin))
    if len(shapes) > 1:
        yield f"views have {len(shapes)} different shapes, {sorted(shapes)[:2]}: scale them to one, encode needs that"
    if blank:
        yield f"state {blank[0]} sees next to nothing ({len(blank)} blank views): such views cannot tell places apart"
    if twins:
        state, twin = twins[0]
        yield f"state {state} has the very same view as state {twin} ({len(twins)} such states): was a file copied?"


def _feature_problems(scene: Scene) -> Iterator[str]:
    assert scene.features is not None
    constant = np.flatnonzero(np.ptp(scene.features, axis=1) == 0)
    if len(constant):
        yield f"state {constant[0]} has features that are all equal ({len(constant)} such states): encode anew"
    if scene.extractor == "unknown":
        yield "what made the features is not said: it cannot be noticed when they are mixed with others; encode anew"


def _ambiguous(scene: Scene, scores: NDArray[np.floating], threshold: float) -> list[tuple[int, int, float, int]]:
    scores = np.maximum(scores, scores.T)
    pairs = np.argwhere(np.triu(scores > threshold, 1))
    order = np.argsort(-scores[tuple(pairs.T)], kind="stable")
    distances = scene.distances
    return [(int(a), int(b), float(scores[a, b]), int(distances[a, b])) for a, b in pairs[order]]


def _matching_problems(
    scene: Scene, scores: NDArray[np.floating], ambiguous: list[tuple[int, int, float, int]], threshold: float
) -> Iterator[str]:
    far = [pair for pair in ambiguous if pair[3] < 0 or pair[3] >= FAR]
    if far:
        a, b, score, distance = far[0]
        apart = "unconnected" if distance < 0 else f"{distance} actions apart"
        yield (
            f"states {a} and {b} match with {score:.3f} though {apart} ({len(far)} pairs above {threshold:g}): on its "
            "way to one an agent stops at the other; choose other goals or a higher threshold"
        )
    for goal in scene.goals:
        reaching = np.flatnonzero((scene.distances[:, goal] > 0) & (scores[:, goal] > threshold))
        if len(reaching):
            worst = reaching[scores[reaching, goal].argmax()]
            yield (
                f"goal {goal} is taken for reached in {len(reaching)} other states, most in state {worst} "
                f"({scores[worst, goal]:.3f}): raise the threshold above that, or choose another goal"
            )
