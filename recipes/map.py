"""Make a map of a first-person video: its frames, and shortcuts between frames of one place.

    python recipes/map.py video=walk.mp4 out=walk.npz field_of_view=65

All options with their values: conf/map/map.yaml.
"""

from dirl.cli.start import run_recipe, start

if __name__ == "__main__":
    start("map")  # answers help and refuses options, before the imports below take their time

from pathlib import Path
from typing import Any

import numpy as np

from dirl.agent.mapping.frames import FrameMap
from dirl.sources.video import read_frames


def main(options: Any) -> None:
    """Read the frames, look for shortcuts, write the map."""
    graph = FrameMap(read_frames(options.video, options.every), options.field_of_view)
    graph.save(options.out)
    far, _ = graph.distances_to(np.array([len(graph.frames) - 1]))
    print(f"| {Path(options.out).name} | |\n|---|--:|")
    print(f"| frames | {len(graph.frames)} |\n| shortcuts | {len(graph.shortcuts)} |")
    print(f"| frames passed from the first to the last | {far[0]:.0f} |")
    print(f"map: {options.out}")


if __name__ == "__main__":
    run_recipe("map", main)
