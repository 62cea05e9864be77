"""Led by a recording in MiniWorld: a walker records its way, and is led to photos of places on it by `dirl.Guide`.

    python examples/walk_miniworld.py episodes=4

In each of five families of rooms and mazes a walker who wanders at random films its way, a frame a step. In an episode
it is put somewhere on the way, and led to a photo of another place on it; as a control, to a random frame of the same
recording. A goal is reached within a metre. Rooms and mazes are synthetic.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dirl.agent.mapping import MapError
from dirl.agent.mapping.frames import FrameMap, find_links, map_recordings
from dirl.agent.mapping.guide import Guide
from dirl.cli.start import run, start
from dirl.config.schemas import option
from dirl.perception.matching import Matcher
from dirl.scenes.live import Pose
from dirl.sources.miniworld import MiniWorld

FAMILIES = ("FourRooms", "TMaze", "YMaze", "Hallway", "MazeS3")

FRAMES, STEPS = 160, 100
"""Of a recording, and of an episode."""

STRIDE, TURN = 0.3, 15.0
"""Metres and degrees from one frame to the next."""

NEAR = 1.0
"""Metres from the goal at which it is reached."""

APART, ASIDE = 1.5, 40.0
"""Metres and degrees between the ends of a link, from which it is wrong."""

HEIGHT, WIDTH, VERTICAL = 180, 240, 60.0
"""Pixels, and degrees from top to bottom."""

ACROSS = 2 * float(np.degrees(np.arctan(WIDTH / HEIGHT * np.tan(np.radians(VERTICAL / 2)))))


@dataclass
class Options:
    """Led by a recording in MiniWorld."""

    episodes: int = option("in each family; 0 counts links alone", 4)
    seed: int = option("of walls and walks", 0)
    points: str | None = option("xfeat | sift; null = what is installed", None)
    families: list[str] = option("of rooms and mazes", list(FAMILIES))


def main(episodes: int, seed: int, points: str | None, families: list[str]) -> None:
    """Print a table: links, goals reached on the way to the photo, and on the way to a random frame."""
    matcher = Matcher(points)
    print("| family | frames | links | wrong | led to the photo | led to a random frame | steps, median |")
    print("|---|--:|--:|--:|--:|--:|--:|")
    for family in families:
        world = MiniWorld(family, seed=seed, height=HEIGHT, width=WIDTH, field_of_view=VERTICAL)
        rng = np.random.default_rng(seed)
        frames, poses = wander(world, rng)
        graph = map_recordings([[(frame, float(n), None) for n, frame in enumerate(frames)]], matcher, ACROSS)
        graph = find_links(graph, matcher)
        wrong = sum(wrong_link(poses[one], poses[two]) for one, two in graph.links)
        reached: list[list[int | None]] = [[], []]
        while len(reached[0]) < episodes:
            start, goal, other = rng.integers(len(frames), size=3)
            if distance(poses[start], poses[goal]) < 3 * NEAR:
                continue
            for found, leading in zip(reached, (goal, other), strict=True):
                world.place(poses[start])
                found.append(episode(world, graph, matcher, frames[leading], poses[goal]))
        steps = [count for count in reached[0] if count is not None]
        led, blind = (sum(count is not None for count in found) for found in reached)
        print(
            f"| {family} | {len(frames)} | {len(graph.links)} | {wrong} | "
            f"{led} of {episodes} | {blind} of {episodes} | {np.median(steps) if steps else float('nan'):.0f} |",
            flush=True,
        )


def wander(world: MiniWorld, rng: np.random.Generator) -> tuple[list[NDArray[np.uint8]], list[Pose]]:
    """Film a walk: straight on for a while, and where a wall is, or at random, to another heading."""
    frames, poses, left = [], [], 0.0
    while len(frames) < FRAMES:
        frames.append(world.look(world.pose.heading))
        poses.append(world.pose)
        if left == 0 and (rng.random() < 0.03 or not world.push(STRIDE)):
            left = float(rng.choice([-1, 1]) * rng.integers(4, 11) * TURN)
        if left != 0:
            pose, step = world.pose, float(np.sign(left)) * TURN
            world.place(Pose(pose.x, pose.z, (pose.heading + step) % 360))
            left -= step
    return frames, poses


def episode(world: MiniWorld, graph: FrameMap, matcher: Matcher, photo: NDArray[np.uint8], goal: Pose) -> int | None:
    """Do what the guide says; the steps until the goal was reached, None if it was not."""
    try:
        guide = Guide(graph, [photo], matcher)
    except MapError:
        return None
    rng = np.random.default_rng(0)
    for step in range(STEPS):
        pose = world.pose
        if distance(pose, goal) <= NEAR:
            return step
        advice = guide.see(world.look(pose.heading))
        turn = -advice.turn  # headings grow to the right here
        if advice.say in ("lost", "stuck"):
            turn = 2 * TURN
        if abs(turn) >= 1:
            world.place(Pose(pose.x, pose.z, (pose.heading + float(np.clip(turn, -45, 45))) % 360))
        if advice.say in ("ahead", "back", "arrived", "stuck") and not world.push(
            -STRIDE if advice.say == "back" else STRIDE
        ):
            # A wall: aside, and on.
            world.place(Pose(pose.x, pose.z, (pose.heading + float(rng.choice([-90, 90]))) % 360))
            world.push(STRIDE)
            world.place(Pose(world.pose.x, world.pose.z, pose.heading))
    return None


def wrong_link(one: Pose, other: Pose) -> bool:
    """True if two frames do not show one place."""
    turn = abs((one.heading - other.heading + 180) % 360 - 180)
    return distance(one, other) > APART or turn > ASIDE


def distance(one: Pose, other: Pose) -> float:
    """Metres between two poses."""
    return float(np.hypot(one.x - other.x, one.z - other.z))


if __name__ == "__main__":
    options = start(__doc__, Options)
    run(lambda: main(**vars(options)))
