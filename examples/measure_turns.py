"""Does the guide turn back whoever looks aside? Frames of recordings, seen by a camera that is turned by known angles.

    python examples/measure_turns.py recordings=LEVELS

LEVELS holds folders of recordings, ``LEVELS/ground/hall/0000.jpg``, one frame a second. Of each the middle 43 degrees
are the map, and somebody walks along it who looks aside all the time: what a camera sees that was turned on the spot is
a homography of the frame. Told is how often the guide's turn, less that for whoever looks straight ahead, goes back.
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from dirl.agent.mapping.frames import map_recordings
from dirl.agent.mapping.guide import Guide
from dirl.cli.start import run, start
from dirl.config.schemas import option
from dirl.perception.matching import Matcher
from dirl.sources.video import Recording

FIELD_OF_VIEW = 65.0
"""Of the camera from left to right, degrees."""

SHARE = 0.625
"""Of the frame's width that is shown; by ten degrees it can be turned to both sides."""

ANGLES = (-10.0, -5.0, 5.0, 10.0)
"""By which the camera is turned to the left, degrees."""


@dataclass
class Options:
    """Does the guide turn back whoever looks aside?"""

    recordings: str = option("a folder of levels, each with folders of recordings")
    points: str | None = option("xfeat | sift; null = what is installed", None)
    every: int = option("of so many recordings one is taken", 1)
    first: int = option("number of the first one that is taken", 0)


def turned(frame: NDArray[np.uint8], angle: float) -> NDArray[np.uint8]:
    """The middle of what a camera sees that was turned to the left on the spot, from a frame, uint8 ``[H, W, 3]``."""
    height, width = frame.shape[:2]
    focal = width / 2 / np.tan(np.radians(FIELD_OF_VIEW / 2))
    size = round(SHARE * width), height
    seen, shown = (np.array([[focal, 0, across / 2], [0, focal, height / 2], [0, 0, 1]]) for across in (width, size[0]))
    cos, sin = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    rotation = np.array([[cos, 0, -sin], [0, 1, 0], [sin, 0, cos]])
    way = seen @ rotation @ np.linalg.inv(shown)
    return np.asarray(cv2.warpPerspective(frame, way, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP), np.uint8)


def main(recordings: str, points: str | None, every: int, first: int) -> None:
    """Print the shares."""
    matcher = Matcher(points)
    half = np.tan(np.radians(FIELD_OF_VIEW / 2))
    shown = 2 * float(np.degrees(np.arctan(SHARE * half)))
    clips = [clip for level in sorted(Path(recordings).iterdir()) for clip in sorted(level.iterdir())]
    off: dict[float, list[float]] = {angle: [] for angle in ANGLES}
    for clip in clips[first::every]:
        frames = [frame.image for frame in Recording(clip, 1.0)]
        straight = [turned(frame, 0.0) for frame in frames]
        graph = map_recordings([[(frame, float(n), None) for n, frame in enumerate(straight)]], matcher, shown)
        told = {angle: Guide(graph, straight[-1:], matcher) for angle in (0.0, *ANGLES)}
        for frame in frames:
            advice = {angle: guide.see(turned(frame, angle)) for angle, guide in told.items()}
            for angle in ANGLES:
                if not {advice[0.0].say, advice[angle].say} & {"lost", "stuck"}:
                    off[angle].append(advice[angle].turn - advice[0.0].turn)
    print("| camera turned to the left by | views | told to turn back | median error |\n|--:|--:|--:|--:|")
    for angle, turns in off.items():
        back = np.mean([turn * angle < 0 for turn in turns])
        print(f"| {angle:.0f} | {len(turns)} | {back:.3f} | {np.median(np.abs(np.array(turns) + angle)):.1f} degrees |")


if __name__ == "__main__":
    options = start(__doc__, Options)
    run(lambda: main(**vars(options)))
