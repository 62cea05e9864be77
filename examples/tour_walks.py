"""Tours whose places change between visits, and photos of a telephone as goals: how often does a navigator get there?

    python examples/tour_walks.py 'path=[my_tour]'
    python examples/tour_walks.py 'path=[tours/a,tours/b]' goal=views changes=mild 'walks_by=[agent,sweep]'

The navigator walks by its own `reset` and `act`, sees eight views and the arrows of each panorama, and remembers. A
goal is four views, or a photo of another camera: upright, of another focal length than the views, aside of their
headings, tilted, in other light and compressed. With changes a place has four looks. One is the goal's, and each visit
shows one of the other three: people, light, headings that are off, and compression differ.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from tqdm import tqdm

import dirl
from dirl.agent import agent
from dirl.cli.start import run, start
from dirl.config.schemas import option
from dirl.evaluation.live_episodes import Remembered
from dirl.reporting.tables import over_scenes, result_table
from dirl.scenes.graph import RIGHT
from dirl.scenes.views import decode, encode
from dirl.sources.tours import read_tour
from dirl.sources.tours.conversion import tour_scene
from dirl.sources.tours.pixels import Pixels, cut, density, read_panorama, sample

VIEW, PHOTO = ((240, 320), 75.0), ((480, 360), 50.0)
"""Height and width, pixels, and the horizontal field of view, degrees."""

LOOKS = 4
"""Of a place that changes; the first one is seen in goals only."""


class Changes(NamedTuple):
    """What differs between two looks."""

    people: float
    """Share of two persons who each stand in a view or not."""
    width: float
    """Of a person, at most, as a share of the view's."""
    heading: float
    """Standard deviation of where a view looks, degrees."""
    light: float
    """Standard deviation of the logarithm of a gain; each colour has a third of it, the exponent 1.3 times as much."""


CHANGES = {"none": None, "mild": Changes(0.3, 0.2, 3.0, 0.15), "hard": Changes(0.9, 0.3, 5.0, 0.25)}

GoalKind = StrEnum("GoalKind", ["photo", "views"])
Change = StrEnum("Change", list(CHANGES))
Walker = StrEnum("Walker", ["agent", "sweep", "without_points", "another_goal", "random"])


@dataclass
class Options:
    """Which tours, what is seen of them, and who walks."""

    path: list[str] = option("folders of tours")
    goal: GoalKind = option("a photo, or the four views around the goal", GoalKind.photo)
    changes: Change = option("of the places between visits", Change.none)
    walks_by: list[Walker] = option("the agent, or controls; the sweep ignores the goal", [Walker.agent])
    angle: bool = option("the navigator is told how wide a photo is, as EXIF does", True)
    episodes: int = option("walks in each tour", 32)
    max_steps: int = option("of a walk", 200)
    seed: int = option("of looks, photos and starts", 0)


class Places:
    """The places of a tour as they look at the walks' goals and at visits.

    Args:
        path: of the tour.
        changes: between the looks; None = none.
        rng: draws them.
    """

    def __init__(self, path: str, changes: Changes | None, rng: np.random.Generator) -> None:
        tour = read_tour(path)
        converted = tour_scene(tour)
        self.scene, self.yaws = converted.scene, converted.yaws
        needed = max(density(*VIEW), density(*PHOTO))
        self.panoramas = [read_panorama(each.image, needed) for each in tqdm(tour.panoramas, "panoramas", disable=None)]
        if changes is None:
            self.looks = [np.stack([cut(self.of(state), yaw, *VIEW) for state, yaw in enumerate(self.yaws.flat)])]
        else:
            self.looks = [self.look(changes, rng) for _ in range(LOOKS)]

    @property
    def turns(self) -> int:
        """In a full circle."""
        return self.yaws.shape[1]

    def of(self, state: int) -> list[Pixels]:
        """Return the panorama of a state."""
        return self.panoramas[state // self.turns]

    def around(self, state: int, turn: int = 1) -> list[int]:
        """Return the states of a full circle of turns to the right, or of every so many of them."""
        states = [state]
        for _ in range(self.turns - 1):
            states.append(int(self.scene.graph[states[-1], RIGHT]))
        return states[::turn]

    def look(self, changes: Changes, rng: np.random.Generator) -> NDArray[np.uint8]:
        """Return all views once more, as something changed, uint8 ``[S, H, W, 3]``."""
        views = []
        for panorama, yaws in zip(self.panoramas, self.yaws, strict=True):
            turned = rng.normal(0, changes.heading)
            gain, gamma = lit(rng, changes.light, changes.light / 3, 1.3 * changes.light)
            for yaw in yaws:
                view = np.clip((cut(panorama, yaw + turned, *VIEW) / 255) ** gamma * gain, 0, 1)
                height, width = view.shape[:2]
                for _ in range(rng.binomial(2, changes.people)):
                    wide, high = int(width * rng.uniform(0.08, changes.width)), int(height * rng.uniform(0.4, 0.8))
                    left = rng.integers(width - wide)
                    clothes = rng.uniform(0, 1, 3) * rng.uniform(0.7, 1, (high, 1, 1))
                    view[height - high :, left : left + wide] = clothes
                views.append(decode(encode((255 * view).astype(np.uint8), 70)))
        return np.stack(views)

    def photo(self, state: int, rng: np.random.Generator) -> Pixels:
        """Return what a telephone sees, some 15 degrees at most aside of a state's heading."""
        size, field_of_view = PHOTO
        focal = density(size, field_of_view)
        right, down = np.meshgrid(*(np.arange(side) + 0.5 - side / 2 for side in size[::-1]))
        rays = np.stack([right, -down, np.full_like(right, focal)], -1)
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        angles = self.yaws.flat[state] + rng.uniform(-15, 15), rng.normal(0, 5), rng.normal(0, 2)
        turned = Rotation.from_euler("YXZ", angles, degrees=True).apply(rays.reshape(-1, 3)).reshape(rays.shape)
        gain, gamma = lit(rng, 0.15, 0.05, 0.2)
        seen = sample(self.of(state), np.moveaxis(turned, -1, 0)) / 255
        return decode(encode((255 * np.clip(seen**gamma * gain, 0, 1)).astype(np.uint8), 60))


def lit(rng: np.random.Generator, gain: float, colour: float, exponent: float) -> tuple[NDArray[np.float64], float]:
    """Draw a light: a factor of each colour, and an exponent."""
    return np.exp(rng.normal(0, gain) + rng.normal(0, colour, 3)), float(np.exp(rng.normal(0, exponent)))


def walk(
    navigator: dirl.Navigator, places: Places, start: int, most: int, rng: np.random.Generator, aimless: bool
) -> tuple[int | None, int]:
    """Return where a navigator stops, None if it does not, and after how many steps; ``aimless`` moves are random."""
    state, seen = start, places.looks[-LOOKS + 1 :]
    graph = places.scene.graph
    for steps in range(most + 1):
        around = places.around(state)
        views = seen[rng.integers(len(seen))][around]
        decision = navigator.act(views, possible=graph[around] >= 0)
        if decision.stop:
            return state, steps
        action = rng.choice(np.flatnonzero(graph[state] >= 0)) if aimless else int(decision.action)
        state = int(graph[state, action]) if graph[state, action] >= 0 else state
    return None, most


def measure(
    places: Places, goals: Sequence[object], pairs: NDArray[np.int64], by: Walker, options: Options
) -> dict[str, float]:
    """Return the measures of walks from starts to goals, as `dirl.reporting.tables.result_table` takes them."""
    navigator = dirl.Navigator.load("general", turns=places.turns)
    navigator.encoder = Remembered(navigator.encoder)
    navigator.points = navigator.points and by != Walker.without_points
    worth = agent.SAVED, agent.CLEAR
    if by == Walker.sweep:
        agent.SAVED = agent.CLEAR = 0.0  # what looks like the goal, or leads to it, is worth no step
    if by == Walker.another_goal:
        goals = [*goals[1:], goals[0]]
    rng, rows = np.random.default_rng(options.seed + 1), []
    try:
        for shown, (start, wanted) in zip(tqdm(goals, by, disable=None), pairs, strict=True):
            known = options.goal == GoalKind.photo and options.angle
            navigator.reset(shown, field_of_view=PHOTO[1] if known else None)
            stopped, steps = walk(navigator, places, int(start), options.max_steps, rng, by == Walker.random)
            arrived, shortest = stopped == wanted, places.scene.distances[start, wanted]
            rows.append((arrived, arrived * shortest / max(steps, shortest), stopped is not None and not arrived))
    finally:
        agent.SAVED, agent.CLEAR = worth
    names = ("sr", "spl", "false_stop_rate")
    return {**dict(zip(names, np.mean(rows, 0).tolist(), strict=True)), "episodes": float(len(rows))}


def main(options: Options) -> None:
    """Walk, and print success and path length, by tour and of all walks."""
    measures: dict[str, dict[str, dict[str, float]]] = {by: {} for by in options.walks_by}
    for path in options.path:
        rng = np.random.default_rng(options.seed)
        places = Places(path, CHANGES[options.changes], rng)
        pairs = rng.choice(np.argwhere(places.scene.distances > 1), options.episodes)
        if options.goal == GoalKind.photo:
            goals: Sequence[object] = [places.photo(int(state), rng) for _, state in pairs]
        else:
            goals = [places.looks[0][places.around(int(state), places.turns // 4)] for _, state in pairs]
        for by in options.walks_by:
            measures[by][places.scene.name] = measure(places, goals, pairs, by, options)
    rows = {f"{name}, {by}": row for by, of in measures.items() for name, row in of.items()}
    print(result_table(rows, leave_out={"ATL", "shortest", "missed"}))
    for by, of in measures.items():
        means = {name: float(np.mean([row[name] for row in of.values()])) for name in ("sr", "false_stop_rate")}
        print(f"\n{by}: SR {means['sr']:.3f}, false stops {means['false_stop_rate']:.3f}. {over_scenes(of)}")


if __name__ == "__main__":
    chosen = start(__doc__, Options)
    run(lambda: main(chosen))
