"""Find the way to a photo by the map of a video.

    python recipes/go.py map=walk.pt photo=goal.jpg start=here.jpg out=way.png

All options: `Options` below.
"""

from dataclasses import dataclass
from typing import Any

from dirl.cli.start import new_file, run, start
from dirl.config.schemas import option


@dataclass
class Options:
    """Find the way to a photo by the map of a video, or say that it was taken elsewhere."""

    map: str = option("a map that recipes/map.py made")
    photo: Any = option("of the goal; several in a row, [1.jpg,2.jpg,3.jpg], or a short video find it more surely")
    start: Any = option("likewise, of where one is; null = where the recording begins", None)
    out: str = option("a new file for the picture of the way; its moves are written beside it, as JSON", "way.png")
    page: str | None = option("a new file (.html): the map, and where the photo was found", None)
    mcap: str | None = option("a new file (.mcap): pictures and moves of the way, for Foxglove or Rerun", None)


if __name__ == "__main__":
    options = start(__doc__, Options)  # "loading ...", or help; the imports below take their time

from itertools import islice, pairwise
from pathlib import Path

import numpy as np

from dirl.agent.mapping.frames import Found, FrameMap, load_frames_map, load_matcher
from dirl.agent.mapping.moves import Move, moves_along
from dirl.config.files import names
from dirl.config.schemas import ConfigError
from dirl.perception.matching import FrameMatcher
from dirl.reporting.inspection import draw_sheet
from dirl.reporting.map_page import write_mcap, write_page
from dirl.scenes.io.files import write_json
from dirl.scenes.views import SUFFIXES
from dirl.sources.video import Recording, read_photo

SHOWN = 16
"""Frames of the path in the picture, at most."""

MOST = 30
"""Frames of a short video that are looked for, at most."""


def main(options: Options) -> None:
    """Locate the photos, tell the moves between them, and draw the way."""
    for file, ending in ((options.out, ".png"), (options.page, ".html"), (options.mcap, ".mcap")):
        if file is not None:
            new_file(file, ending=ending)
    graph = load_frames_map(options.map)
    matcher = load_matcher(graph.kind)
    here = None if options.start is None else locate(graph, matcher, "start", options.start)
    goal = locate(graph, matcher, "photo", options.photo)
    print("| photo | frame | second | points that agree | |\n|---|--:|--:|--:|---|")
    for name, found in ((options.start or "the first frame", here), (options.photo, goal)):
        frame = 0 if found is None else found.frame
        told = "| |" if found is None else f"{found.scores.max():.0f} | {found.answer} ({found.probability:.2f}) |"
        print(f"| {name} | {frame} | {graph.times[frame]:.0f} | {told}")
    for name, found in (("start", here), ("photo", goal)):
        if found is not None and found.answer == "not here":
            raise ConfigError(
                f"{name}={getattr(options, name)}: was not taken where the map was recorded; the most similar frame is "
                f"{found.frame}"
            )
    start = 0 if here is None else here.frame
    path = graph.path(start, goal.frame)
    if not path:
        raise ConfigError(f"photo={options.photo}: nothing links its recording with that of the start")
    moves = moves_along(graph, matcher, path)
    jumps = sum(abs(after - before) > 1 for before, after in pairwise(path))
    print(f"\nway: {len(path)} frames, {jumps} links\n\n| move | until frame |\n|---|--:|")
    for move in moves:
        print(f"| {move} | {move.frame} |")
    shown = [path[place] for place in np.unique(np.linspace(0, len(path) - 1, SHOWN).round().astype(int))]
    draw_sheet([(f"frame {node}", graph.picture(node)) for node in shown], Path(options.out), ends=True)
    print(f"picture: {options.out}")
    listed = Path(options.out).with_suffix(".json")
    write_json(listed, describe_way(graph, path, moves, goal, here))
    print(f"moves: {listed}")
    if options.page is not None:
        write_page(graph, Path(options.page), path, goal)
        print(f"page: {options.page}")
    if options.mcap is not None:
        texts = {move.frame: str(move) for move in reversed(moves)}
        seconds = np.arange(len(path)) * graph.spacing
        told_with = [texts.get(frame, "") for frame in path]
        pictures = zip(seconds.tolist(), map(graph.picture, path), told_with, strict=True)
        write_mcap(Path(options.mcap), pictures)
        print(f"mcap: {options.mcap}")


def locate(graph: FrameMap, matcher: FrameMatcher, option: str, sources: Any) -> Found:
    """Where a photo, several or a short video were taken."""
    files = names(option, sources)
    if len(files) == 1 and Path(files[0]).suffix.lower() not in SUFFIXES:
        frames = [frame.image for frame in islice(Recording(Path(files[0]), graph.spacing), MOST + 1)]
        if len(frames) > MOST:
            raise ConfigError(f"{option}={files[0]}: is too long; {MOST * graph.spacing:.0f} s are enough")
    else:
        frames = [read_photo(file) for file in files]
    return graph.find(matcher, matcher.describe(frames))


def describe_way(
    graph: FrameMap, path: list[int], moves: list[Move], goal: Found, here: Found | None
) -> dict[str, object]:
    """The way as JSON has it."""
    ends = {"start": here, "goal": goal}
    return {
        name: {"frame": found.frame, "answer": found.answer, "probability": found.probability}
        for name, found in ends.items()
        if found is not None
    } | {
        "path": [{"frame": frame, "seconds": float(graph.times[frame])} for frame in path],
        "moves": [
            {"turn_left_degrees": move.turn, "ahead_seconds": move.ahead, "until_frame": move.frame} for move in moves
        ],
    }


if __name__ == "__main__":
    run(lambda: main(options), options)
