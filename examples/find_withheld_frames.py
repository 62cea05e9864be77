"""How surely are photos found in recordings? Every second frame is the map, the others are looked for.

    python examples/find_withheld_frames.py recordings=LEVELS elsewhere=PHOTOS out=withheld points=xfeat

LEVELS holds folders of recordings, ``LEVELS/ground/hall/0000.jpg``, one frame a second, all of which become one map. A
frame is found if the map's frame was taken at most one second before or after it. PHOTOS, a folder of images, were
taken elsewhere. Frames are also looked for in the map of all levels but their own. To see what is linked, every second
frame of each recording becomes a recording of its own; a link between levels is wrong. Written are tables, ``OUT.md``,
and precision against coverage, ``OUT.png``.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from tqdm import tqdm

from dirl.agent.mapping.frames import Found, FrameMap, find_links, map_recordings
from dirl.cli.start import run, start
from dirl.config.schemas import option
from dirl.perception.matching import Described, Matcher
from dirl.reporting.style import plain
from dirl.scenes.views import natural_order
from dirl.sources.video import Recording, read_photo

COVERAGES = (0.4, 0.6, 0.8)

CLIP = 5
"""Photos of a short film."""


@dataclass
class Options:
    """How surely photos are found in recordings."""

    recordings: str = option("a folder of levels, each with folders of recordings")
    out: str = option("table and picture to write, without .md and .png")
    elsewhere: str | None = option("a folder of photos that were taken elsewhere", None)
    points: str | None = option("xfeat | sift; null = what is installed", None)
    left_out: int = option("of so many frames one is looked for without its level", 4)


def main(recordings: str, out: str, elsewhere: str | None, points: str | None, left_out: int) -> None:
    """Write table and picture."""
    matcher = Matcher(points)
    clips = [clip for level in sorted(Path(recordings).iterdir()) for clip in sorted(level.iterdir())]
    sources = [Recording(clip, 1.0) for clip in clips]
    whole = map_recordings(sources, matcher, 65.0, sum(source.count for source in sources), progress=True)
    level = np.array([clip.parent.name for clip in clips])[whole.parts]
    frames = np.arange(len(whole))
    kept = frames[frames % 2 == 0]
    inside = (whole.parts[:-2] == whole.parts[1:-1]) & (whole.parts[2:] == whole.parts[1:-1])
    asked = 1 + np.flatnonzero(inside & (frames[1:-1] % 2 == 1))
    graph = part_of(whole, kept)
    scores = {int(one): graph.score(matcher, whole.described[one : one + 1]) for one in tqdm(asked, desc="photos")}
    lines = ["| | answers | within 1 s | within 5 s | certain | of them right | precision at coverage .4, .6, .8 |"]
    lines.append("|---|--:|--:|--:|--:|--:|---|")
    curves = {}
    first_half = np.unique(level)[::2]  # thresholds were chosen on these
    for name, some in (
        ("all", asked),
        ("levels 1, 3, ...", asked[np.isin(level[asked], first_half)]),
        ("levels 2, 4, ...", asked[~np.isin(level[asked], first_half)]),
    ):
        for count in (1, CLIP):
            around = [[one + 2 * step for step in range(-(count // 2), count // 2 + 1)] for one in some]
            films = [film for film in around if all(one in scores and same(whole, one, film[0]) for one in film)]
            found = [graph.combine([scores[one] for one in film]) for film in films]
            text, curve = measures(whole, kept, [film[count // 2] for film in films], found)
            lines.append(f"| {name}, {'a photo' if count == 1 else f'{count} photos'} | {text}")
            if name == "all":
                curves[f"{count} photo{'s' * (count > 1)}"] = curve
    first = np.unique(level)[0]
    own, few = kept[level[kept] == first], asked[level[asked] == first]
    alone = part_of(whole, own)
    found = [alone.find(matcher, whole.described[frame : frame + 1]) for frame in tqdm(few, desc=first)]
    lines.append(f"| {first} alone, a photo | {measures(whole, own, few.tolist(), found)[0]}")
    absent: list[Found] = []
    for one in np.unique(level):
        others = part_of(whole, kept[level[kept] != one])
        few = asked[level[asked] == one][::left_out]
        absent += [others.find(matcher, whole.described[frame : frame + 1]) for frame in tqdm(few, desc=f"not {one}")]
    lines += ["", "| taken elsewhere | photos | certain | uncertain | not here |", "|---|--:|--:|--:|--:|"]
    lines.append(f"| on a level that the map lacks | {shares(absent)}")
    if elsewhere is not None:
        files = sorted((file for file in Path(elsewhere).iterdir() if file.suffix == ".jpg"), key=natural_order)
        away = matcher.describe(read_photo(file) for file in tqdm(files, desc="elsewhere"))
        lines.append(
            f"| in other buildings | {shares([graph.find(matcher, away[n : n + 1]) for n in range(len(away))])}"
        )
    order = np.lexsort((frames, frames % 2, whole.parts))
    twice = replace(part_of(whole, order), parts=2 * whole.parts[order] + order % 2)
    ends = level[order][find_links(twice, matcher, progress=True).links]
    wrong = np.mean(ends[:, 0] != ends[:, 1])
    lines += ["", "| links between recordings | between levels |", "|--:|--:|", f"| {len(ends)} | {wrong:.3f} |"]
    text = "\n".join(lines)
    Path(f"{out}.md").write_text(text + "\n")
    draw(curves, Path(f"{out}.png"))
    print(text)


def same(whole: FrameMap, one: int, other: int) -> bool:
    """True if two frames are of one recording."""
    return bool(whole.parts[one] == whole.parts[other])


def part_of(whole: FrameMap, frames: NDArray[np.int64]) -> FrameMap:
    """The map of some of the frames."""
    pictures, links = [whole.pictures[frame] for frame in frames], np.zeros((0, 2), np.int64)
    described: Described = whole.described[frames]
    return FrameMap(pictures, whole.times[frames], whole.parts[frames], described, links, 65.0, whole.kind, whole.size)


def measures(
    whole: FrameMap, kept: NDArray[np.int64], asked: list[int], found: list[Found]
) -> tuple[str, NDArray[np.float64]]:
    """A row of the table, and the precision of the surest answers, by how many there are."""
    answers = np.array([kept[one.frame] for one in found])
    off = np.abs(whole.times[answers] - whole.times[asked])
    off[whole.parts[answers] != whole.parts[asked]] = np.inf
    right, surest = off <= 1, np.argsort([-one.probability for one in found], kind="stable")
    certain = np.array([one.answer == "certain" for one in found])
    precision = np.cumsum(right[surest]) / np.arange(1, len(found) + 1)
    at = " ".join(f"{precision[int(part * len(found)) - 1]:.3f}" for part in COVERAGES)
    correct = right[certain].mean() if certain.any() else float("nan")
    text = (
        f"{len(found)} | {right.mean():.3f} | {(off <= 5).mean():.3f} | {certain.mean():.3f} | {correct:.3f} | {at} |"
    )
    return text, precision


def shares(found: list[Found]) -> str:
    """How often each answer was given."""
    parts = [np.mean([one.answer == answer for one in found]) for answer in ("certain", "uncertain", "not here")]
    return f"{len(found)} | " + " | ".join(f"{part:.3f}" for part in parts) + " |"


def draw(curves: dict[str, NDArray[np.float64]], file: Path) -> None:
    """Precision against coverage."""
    figure = Figure(figsize=(5, 3.2), layout="constrained")
    axes = figure.subplots()
    for name, precision in curves.items():
        axes.plot(np.arange(1, len(precision) + 1) / len(precision), precision, label=name)
    axes.set(xlabel="coverage: share of photos that are answered", ylabel="precision", xlim=(0, 1), ylim=(0.7, 1.005))
    axes.legend()
    plain(axes)
    figure.savefig(file, dpi=150)


if __name__ == "__main__":
    options = start(__doc__, Options)
    run(lambda: main(**vars(options)))
