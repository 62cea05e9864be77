"""Make a map of a first-person video: its frames, and shortcuts between frames of one place.

    python recipes/map.py video=walk.mp4 out=walk.npz field_of_view=65

All options: `Options` below.
"""

from dataclasses import dataclass
from typing import Annotated

from dirl.cli.start import run, start
from dirl.config.bounds import Bounds
from dirl.config.options import option
from dirl.config.schemas import Positive


@dataclass
class Options:
    """Make a map of a first-person video."""

    video: str = option("a video, or a folder of images in the order of their names")
    out: str = option("a new file (.npz) for the map")
    every: Positive = option("one of so many frames is kept; the views of successive ones must overlap", 4)
    field_of_view: Annotated[float, Bounds(10, 150)] = option(
        "of the camera from left to right, degrees; a phone held upright has about 50", 90
    )


if __name__ == "__main__":
    options = start(__doc__, Options)  # "loading ...", or help; the imports below take their time


import numpy as np

from dirl.agent.mapping.frames import FrameMap
from dirl.cli.output import new_file
from dirl.sources.video import read_frames


def main(options: Options) -> None:
    """Read the frames, look for shortcuts, write the map."""
    out = new_file(options.out, ending=".npz")
    graph = FrameMap(read_frames(options.video, options.every), options.field_of_view)
    graph.save(out)
    far, _ = graph.distances_to(np.array([len(graph.frames) - 1]))
    print(f"| {out.name} | |\n|---|--:|")
    print(f"| frames | {len(graph.frames)} |\n| shortcuts | {len(graph.shortcuts)} |")
    print(f"| frames passed from the first to the last | {far[0]:.0f} |")
    print(f"map: {out}")


if __name__ == "__main__":
    run(lambda: main(options))
