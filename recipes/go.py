"""Find the path to a photo by the map of a video.

    python recipes/go.py map=walk.npz photo=goal.jpg start=here.jpg out=way.png

All options: `Options` below.
"""

from dataclasses import dataclass

from dirl.cli.start import run, start
from dirl.config.options import option


@dataclass
class Options:
    """Find the path to a photo by the map of a video."""

    map: str = option("a map that recipes/map.py made")
    photo: str = option("of the goal")
    start: str | None = option("a photo of where one is; null = where the recording begins", None)
    out: str = option("a new file for the picture of the path", "way.png")


if __name__ == "__main__":
    options = start(__doc__, Options)  # "loading ...", or help; the imports below take their time

from itertools import pairwise

import numpy as np

from dirl.agent.mapping.frames import KNOWN, fits, load_frames_map
from dirl.cli.output import new_file
from dirl.config.schemas import ConfigError
from dirl.reporting.strips import draw_strip
from dirl.sources.video import read_photo

SHOWN = 16
"""Frames of the path in the picture, at most."""


def main(options: Options) -> None:
    """Locate the photos, and draw the path between them."""
    out = new_file(options.out, ending=".png")
    graph = load_frames_map(options.map)
    height = graph.frames.shape[1]
    goal = read_photo(options.photo, height)
    here = graph.frames[0] if options.start is None else read_photo(options.start, height)
    ends = []
    print("| photo | frame | correlation | |\n|---|--:|--:|---|")
    for name, photo in ((options.start or "the first frame", here), (options.photo, goal)):
        found = fits(graph, photo)
        ends.append(int(found.argmax()))
        print(f"| {name} | {ends[-1]} | {found.max():.2f} | {'' if found.max() >= KNOWN else 'uncertain'} |")
    far, following = graph.distances_to(np.array(ends[1:]))
    if not np.isfinite(far[ends[0]]):
        raise ConfigError(f"photo={options.photo}: no path leads there; the recording shows it only before the start")
    path = [ends[0]]
    while far[path[-1]] > 0:
        path.append(int(following[path[-1]]))
    jumps = sum(abs(after - before) > 1 for before, after in pairwise(path))
    print(f"path: {len(path)} frames, {jumps} shortcuts")
    shown = [path[place] for place in np.unique(np.linspace(0, len(path) - 1, SHOWN).round().astype(int))]
    pictures = [("here", here), *((f"frame {node}", graph.frames[node]) for node in shown), ("goal", goal)]
    draw_strip(pictures, out)
    print(f"picture: {options.out}")


if __name__ == "__main__":
    run(lambda: main(options))
