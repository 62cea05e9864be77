"""A tour, and photos of its places as a telephone takes them: how often does a navigator get there?

    python examples/phone_photos.py path=my_tour

Each photo is upright, of another focal length than the views, aside of their headings, tilted, in other light and
compressed. The navigator walks by its own `reset` and `act` and sees eight views and the arrows of each panorama.
"""

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from tqdm import tqdm

import dirl
from dirl.agent import agent
from dirl.cli.start import run, start
from dirl.config.schemas import option
from dirl.evaluation.live_episodes import Remembered
from dirl.scenes.graph import RIGHT
from dirl.scenes.views import decode, encode
from dirl.sources.tours import read_tour
from dirl.sources.tours.conversion import tour_scene
from dirl.sources.tours.pixels import Pixels, cut, density, read_panorama, sample

VIEW, PHOTO = ((240, 320), 75.0), ((480, 360), 50.0)
"""Height and width, pixels, and the horizontal field of view, degrees."""


@dataclass
class Options:
    """Which tour, and who walks."""

    path: str = option("the folder of a tour")
    walks_by: str = option("agent | sweep, which ignores the goal | learned, without points | another goal", "agent")
    angle: bool = option("the navigator is told how wide a photo is, as EXIF does", True)
    episodes: int = option("walks", 32)
    max_steps: int = option("of a walk", 200)
    seed: int = option("of photos and starts", 0)


def photo(panorama: list[Pixels], yaw: float, rng: np.random.Generator) -> Pixels:
    """Return what a telephone sees of a panorama, some 15 degrees at most aside of a heading."""
    size, field_of_view = PHOTO
    focal = density(size, field_of_view)
    right, down = np.meshgrid(*(np.arange(side) + 0.5 - side / 2 for side in size[::-1]))
    rays = np.stack([right, -down, np.full_like(right, focal)], -1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    angles = yaw + rng.uniform(-15, 15), rng.normal(0, 5), rng.normal(0, 2)
    turned = Rotation.from_euler("YXZ", angles, degrees=True).apply(rays.reshape(-1, 3)).reshape(rays.shape)
    gain, gamma = np.exp(rng.normal(0, 0.15) + rng.normal(0, 0.05, 3)), np.exp(rng.normal(0, 0.2))
    seen = sample(panorama, np.moveaxis(turned, -1, 0)) / 255
    return decode(encode((255 * np.clip(seen**gamma * gain, 0, 1)).astype(np.uint8), 60))


def walk(
    navigator: dirl.Navigator, views: NDArray[np.uint8], graph: NDArray[np.int64], start: int, most: int
) -> tuple[int | None, int]:
    """Return where a navigator stops, None if it does not, and after how many steps."""
    state = start
    for steps in range(most + 1):
        around = [state]
        while len(around) < navigator.turns:
            around.append(int(graph[around[-1], RIGHT]))
        decision = navigator.act(views[around], possible=graph[around] >= 0)
        if decision.stop:
            return state, steps
        after = graph[state, int(decision.action)]
        state = state if after < 0 else int(after)
    return None, most


def main(path: str, walks_by: str, angle: bool, episodes: int, max_steps: int, seed: int) -> None:
    """Walk, and print success and path length."""
    if walks_by not in ("agent", "sweep", "learned", "another goal"):
        raise ValueError(f"walks_by={walks_by}: choose from agent, sweep, learned, another goal")
    tour = read_tour(path)
    converted = tour_scene(tour)
    scene, turns = converted.scene, converted.yaws.shape[1]
    needed = max(density(*VIEW), density(*PHOTO))
    panoramas = [read_panorama(each.image, needed) for each in tqdm(tour.panoramas, desc="panoramas", disable=None)]
    views = np.stack([cut(panoramas[i // turns], yaw, *VIEW) for i, yaw in enumerate(converted.yaws.flat)])
    navigator = dirl.Navigator.load("general", turns=turns)
    navigator.encoder = Remembered(navigator.encoder)
    navigator.points = navigator.points and walks_by != "learned"
    if walks_by == "sweep":
        agent.SAVED = 0.0  # what looks like the goal is worth no step
    rng = np.random.default_rng(seed)
    goal, start = rng.choice(np.argwhere(scene.distances > 1), episodes).T[::-1]
    photos = [photo(panoramas[state // turns], converted.yaws.flat[state], rng) for state in goal]
    if walks_by == "another goal":
        photos = [*photos[1:], photos[0]]
    ends, lengths = Counter[str](), []
    for shown, wanted, first in zip(tqdm(photos, desc="walks", disable=None), goal, start, strict=True):
        navigator.reset(shown, field_of_view=PHOTO[1] if angle else None)
        stopped, steps = walk(navigator, views, scene.graph, int(first), max_steps)
        there = stopped is not None and bool(stopped == wanted)
        ends["arrived" if there else "lost" if stopped is None else "false stop"] += 1
        shortest = scene.distances[first, wanted]
        lengths.append(shortest / max(steps, shortest) if there else 0.0)
    false = ends["false stop"] / episodes
    rates = f"SR {ends['arrived'] / episodes:.3f}, SPL {np.mean(lengths):.3f}, false stops {false:.3f}"
    print(f"{scene.name}, {walks_by}, angle={angle}: {rates} ({episodes} walks)")


if __name__ == "__main__":
    options = start(__doc__, Options)
    run(lambda: main(**vars(options)))
