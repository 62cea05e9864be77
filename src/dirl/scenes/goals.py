"""Goals by rule: all states of a scene, every k-th, or a fraction of its places; and places held out of training."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from dirl.scenes.graph import IntArray, places
from dirl.scenes.scene import Scene, SceneError
from dirl.scenes.world import Goals

RULES = "all, every:N (every N-th state) or fraction:S (a fraction of the places, above 0 and at most 1)"


class ChosenGoals(NamedTuple):
    """Which states are goals."""

    trained: Goals
    """As `dirl.scenes.make_world` takes them."""
    held_out: dict[str, tuple[int, ...]]
    """Those of the places held out, by scene; empty if none are."""
    left_out: dict[str, tuple[int, ...]]
    """The states of each scene that are no goals because most states cannot reach them; scenes without are left out."""


def choose_goals(scenes: Sequence[Scene], goals: Goals | str, hold_out: float = 0.0, seed: int = 0) -> ChosenGoals:
    """Choose goals by rule.

    The seed orders the places of each scene, independently of other scenes: the first are held out, and a fraction is
    taken from the end. With the same seed a larger fraction contains a smaller one, and the held-out places do not
    depend on the rule. Places of goals that are given by number are not held out.

    Args:
        scenes: of distinct names.
        goals: `RULES`, for all scenes, or in a mapping for one; else states as `dirl.scenes.make_world` takes them.
        hold_out: the fraction of each scene's places whose states are no goals of the training, 0 to below 1.
        seed: of the order of places.

    Raises:
        SceneError: a rule that does not exist, or that leaves a scene without a goal.
    """
    by_name = goals if isinstance(goals, Mapping) else {scene.name: goals for scene in scenes}
    if not hold_out and not any(isinstance(rule, str) for rule in by_name.values()):
        return ChosenGoals(goals, {}, {})  # type: ignore[arg-type]
    if not isinstance(goals, Mapping | str | None) and len(scenes) > 1:
        return ChosenGoals(goals, {}, {})  # make_world says what is wrong with it
    trained: Any = dict(by_name)
    held_out, left_out = {}, {}
    for scene in scenes:
        rule = by_name.get(scene.name)
        named = _named(scene, rule)
        reached = well_reached(scene)
        place = places(scene.graph)
        order = np.random.default_rng(seed).permutation(int(place.max()) + 1)
        order = order[~np.isin(order, place[list(named)])]  # places of goals that are given are not held out
        held = np.isin(place, order[: _count(hold_out, place)] if hold_out else [])
        if isinstance(rule, str):
            chosen = _by_rule(scene, rule, place, order, hold_out) & reached & ~held
            trained[scene.name] = _states(scene, chosen, f"={rule}")
        else:
            trained[scene.name] = named
        if hold_out:
            held_out[scene.name] = _states(scene, held & reached, f", hold_out={hold_out:g}")
        if not reached.all():
            left_out[scene.name] = tuple(np.flatnonzero(~reached).tolist())
    return ChosenGoals(trained, held_out, left_out)


def well_reached(scene: Scene) -> np.ndarray:
    """Return True where a state can be reached from the scene's largest part, bool ``[N]``: all in a connected scene.

    All states of a part can be reached from each other. A dead end that has no way out takes no goals from others.
    """
    from scipy.sparse import csr_array  # here, see `dirl.scenes.graph.shortest_distances`
    from scipy.sparse.csgraph import connected_components

    start, action = np.nonzero(scene.graph >= 0)
    moves = csr_array((np.ones(len(start)), (start, scene.graph[start, action])), shape=(len(scene), len(scene)))
    part = connected_components(moves, directed=True, connection="strong")[1]
    if part.max() == 0:  # which is known long before all distances are
        return np.ones(len(scene), bool)
    return np.asarray((scene.distances >= 0).sum(0) >= np.bincount(part).max())


def _named(scene: Scene, rule: Any) -> tuple[int, ...]:
    if isinstance(rule, str):
        return ()
    if rule is None:
        return scene.goals
    states = tuple(rule) if isinstance(rule, Sequence) else (rule,)
    scene.check_goals(states)
    return states


def _count(fraction: float, place: IntArray) -> int:
    return max(1, round(fraction * (int(place.max()) + 1)))


def _by_rule(scene: Scene, rule: str, place: IntArray, order: IntArray, hold_out: float) -> np.ndarray:
    """Return which states a rule chooses, bool ``[N]``."""
    kind, _, given = rule.partition(":")
    states = np.arange(len(scene))
    if rule == "all":
        return states >= 0
    try:
        number = float(given)
    except ValueError:
        number = np.nan
    if kind == "every" and number >= 1 and number.is_integer():
        return states % int(number) == 0
    if kind != "fraction" or not 0 < number <= 1:
        raise SceneError(f"{scene.name}: goals={rule}: must be states, or one of {RULES}")
    if number + hold_out > 1 + 1e-9:
        raise SceneError(f"{scene.name}: goals={rule} and hold_out={hold_out:g} are more than all places")
    return np.isin(place, order[-_count(number, place) :])


def _states(scene: Scene, chosen: np.ndarray, rule: str) -> tuple[int, ...]:
    states = tuple(np.flatnonzero(chosen).tolist())
    if not states:
        raise SceneError(f"{scene.name}: goals{rule}: leaves no goal")
    return states
