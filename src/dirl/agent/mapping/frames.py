"""A map of recordings: their frames, what followed what, and links between frames of one place.

Unlike an `ImageGraph` it needs no grid of moves: turns are continuous, and only what lies ahead is seen. As in SPTM
(Savinov et al., ICLR 2018) frames of one place that were taken at different times are linked, here where their points
agree on one geometry, for a window of frames. A photo is found by `FrameMap.find`, which can also say that it was taken
elsewhere. It holds photographs or frames of a game, by what compares them (`dirl.perception.matching.FrameMatcher`).
"""

import os
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra
from torch import Tensor
from tqdm import tqdm

from dirl.agent.mapping.image_graph import MapError
from dirl.perception.columns import load_column_net
from dirl.perception.matching import SCALES, SHORTLIST, Described, FrameMatcher, Matcher, Motion, Scale, fit_closely
from dirl.runs.checkpoints import RunError, read_archive, save_checkpoint
from dirl.scenes.views import encode, open_image, to_rgb

SCHEMA = 4

NEIGHBOURS = 0.5
"""What the frames before and after count, beside the frame itself: a place is seen from both."""

RIVALS, RIVAL = 5, 0.7
"""Of the best frames so many at most are compared closely, if they score so much of what the best one does."""

APART = 6.0
"""Seconds from which another frame is another place, unless links say that it is not."""

BACKWARDS = 2.0
"""What going back along a recording by one frame costs; going on costs 1."""

PICTURE = 240
"""Pixels of the longer side of the pictures that a map keeps to be shown."""

BYTES = 50_000
"""Of a frame in a map, about."""

EVERY = 0.55
"""Seconds between frames that are compared for links."""

NEAR, TURNED = 90.0, 35.0
"""Units and degrees between the ends of a link, at most, where points tell."""

STRIDE, TURN = 40.0, 28.0
"""Units and degrees of a step of a game: so many make a link cost as much as another frame."""

FAR = 300.0
"""Units from which a frame that fits a photo counts exp(-1) of one that was taken where the photo was, likewise."""

WINDOW = 6
"""Frames around the end of a link to which the other end is not linked, too."""

DRIFT, ASTRAY = (20.0, 0.15), (2.0, 0.05)
"""Degrees that the moves from one end of a link to the other may be off, and more for each frame between; and steps
that they may lead away from it, and more for each step."""

TURNS = 12.0
"""Degrees from one frame to the next, from which one is taken to turn on the spot, whatever the points tell."""

RIGHT = 4.2, 1.1, -7.5
"""Of a logistic regression of right answers: log ratio to the best other place, log score, constant."""

CERTAIN = 0.95
"""Least probability of an answer that is called certain."""


class Found(NamedTuple):
    """Where photos were taken."""

    frame: int
    """The one that fits the (middle) photo best."""
    answer: Literal["certain", "uncertain", "not here"]
    probability: float
    """That the frame is right."""
    scores: NDArray[np.float64]
    """Of every frame: points that agree, ``[N]``."""


@dataclass
class FrameMap:
    """Frames of recordings, in order of time, and the paths between them.

    Args:
        pictures: of the frames, small, as WebP.
        times: seconds from the beginning of its recording, ``[N]``.
        parts: number of the recording that a frame is of, int ``[N]``.
        described: what frames are compared by.
        links: pairs of frames of one place, the earlier one first, int ``[L, 2]``.
        field_of_view: of the camera from left to right, degrees.
        kind: of the `FrameMatcher` that described the frames.
        size: height and width of the frames as they were described, pixels.
        places: x, y (metres) and heading (degrees to the left) by odometry, ``[N, 3]``; None without.
        costs: of going along each link, where going on by a frame costs 1, ``[L]``; 1 each if left out.
    """

    pictures: Sequence[bytes]
    times: NDArray[np.float64]
    parts: NDArray[np.int64]
    described: Described
    links: NDArray[np.int64]
    field_of_view: float
    kind: str
    size: tuple[int, int]
    places: NDArray[np.float64] | None = None
    costs: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        count = len(self)
        before = np.flatnonzero(self.parts[1:] == self.parts[:-1])
        one, two = self.links.T
        first = np.concatenate([before, before + 1, one, two])
        second = np.concatenate([before + 1, before, two, one])
        along = np.ones(len(one)) if self.costs is None else self.costs
        cost = np.concatenate([np.ones(len(before)), np.full(len(before), BACKWARDS), along, along])
        self.graph: csr_array = coo_array((cost, (first, second)), shape=(count, count)).tocsr()

    def __len__(self) -> int:
        return len(self.times)

    @property
    def scale(self) -> Scale:
        """What numbers of points that agree mean."""
        return SCALES[self.kind]

    def picture(self, frame: int) -> NDArray[np.uint8]:
        """Return a frame, small, RGB, uint8 ``[h, w, 3]``."""
        return np.asarray(to_rgb(open_image(self.pictures[frame], PICTURE**2)))

    def path(self, start: int, goal: int) -> list[int]:
        """Return the frames of the path from one to another; empty if nothing leads there."""
        far, following = dijkstra(self.graph.T, indices=goal, return_predecessors=True)
        path = [start] if np.isfinite(far[start]) else []
        while path and path[-1] != goal:
            path.append(int(following[path[-1]]))
        return path

    def motion(self, matcher: FrameMatcher, frame: int, other: int) -> Motion | None:
        """Return the motion from one frame to another; None if too few of their points agree."""
        return matcher.motion(self.described[frame : frame + 1], self.described, other, self.size, self.field_of_view)

    def same_place(self, frame: int) -> NDArray[np.bool_]:
        """Return which frames may show the place of one, bool ``[N]``: near in time to it, or to those linked to it."""
        near = np.zeros(len(self), bool)
        for at in {frame, *self.links[(self.links == frame).any(1)].ravel().tolist()}:
            near |= (np.abs(self.times - self.times[at]) <= APART) & (self.parts == self.parts[at])
        return near

    @property
    def spacing(self) -> float:
        """Seconds from one frame to the next, usually."""
        steps = np.diff(self.times)[self.parts[1:] == self.parts[:-1]]
        return float(np.median(steps)) or 1.0

    def find(self, matcher: FrameMatcher, photos: Described) -> Found:
        """Find where photos were taken, or say that it was not here.

        Args:
            matcher: of the kind that described the frames.
            photos: one, or several in a row, as of a short video: those that a walk shows one after the other, about as
                often as the map has frames, in this direction or the other, or that were taken at one place.
        """
        for name in ("looks", "vectors"):
            if getattr(photos, name).shape[1:] != getattr(self.described, name).shape[1:]:
                raise MapError("the frames of the map are described in another way than the photos; make it anew")
        return self.combine([self.score(matcher, photos[number : number + 1]) for number in range(len(photos))])

    def combine(self, each: Sequence[NDArray[np.float64]]) -> Found:
        """Return where photos in a row were taken whose scores are known."""
        frames, hypotheses = np.arange(len(self)), []
        for direction in (1, -1, 0) if len(each) > 1 else (0,):
            total = np.zeros(len(self))
            for number, scores in enumerate(each):
                shown = frames + direction * (number - len(each) // 2)
                at = np.clip(shown, 0, len(self) - 1)
                total += np.where((self.parts[at] == self.parts) & (at == shown), scores[at], 0)
            hypotheses.append(total)
        scores = np.max(hypotheses, 0) / len(each)
        frame = int(scores.argmax())
        best, other = scores[frame], scores[~self.same_place(frame)].max(initial=0)
        margin, points, constant = RIGHT
        logit = margin * np.log((best + 3) / (other + 3)) + points * np.log(best + 1) + constant
        probability = float(1 / (1 + np.exp(-logit)))
        if best < self.scale.here:
            return Found(frame, "not here", probability, scores)
        return Found(frame, "certain" if probability >= CERTAIN else "uncertain", probability, scores)

    def score(self, matcher: FrameMatcher, photo: Described) -> NDArray[np.float64]:
        """Return how well each frame and its neighbours fit one photo, ``[N]``."""
        likeness = matcher.likeness(photo, self.described)
        agreeing = np.zeros(len(self))
        shortlist = np.argsort(-likeness)[:SHORTLIST]
        fit = matcher.fit(photo, self.described, shortlist.tolist())
        agreeing[shortlist] = fit.score * np.exp(-np.hypot(fit.ahead, fit.right) / FAR)
        joined = self.parts[1:] == self.parts[:-1]
        scores = agreeing.copy()
        scores[1:] += NEIGHBOURS * agreeing[:-1] * joined
        scores[:-1] += NEIGHBOURS * agreeing[1:] * joined
        scores += self.scale.look * likeness.clip(min=0)
        best = np.argsort(-scores)[:RIVALS]
        best = best[scores[best] >= RIVAL * scores[best[0]]]
        if self.scale.learned and not self.same_place(int(best[0]))[best].all():
            closely = fit_closely(photo, self.described, best.tolist(), self.size)
            scores[best] += self.scale.learned * closely - agreeing[best]
        return scores

    def save(self, file: str | Path) -> None:
        """Write the map, sealed with a digest as checkpoints are."""
        known: dict[str, Any] = {field.name: getattr(self, field.name) for field in fields(self)}
        known |= known.pop("described").arrays
        known["lengths"] = [len(picture) for picture in self.pictures]
        known["pictures"] = np.frombuffer(bytearray().join(self.pictures), np.uint8)
        arrays = {name: value for name, value in known.items() if isinstance(value, np.ndarray)}
        tensors = {name: torch.from_numpy(np.require(array, requirements="W")) for name, array in arrays.items()}
        save_checkpoint(Path(file), {**known, **tensors, "schema": SCHEMA})


def load_frames_map(file: str | Path) -> FrameMap:
    """Read a map that was saved; `MapError` if there is none, or it is damaged."""
    try:
        known = read_archive(Path(file))
        if known.pop("schema", 1) != SCHEMA:
            raise MapError(f"{file}: is a map of another version; make it anew with dirl map")
        known = {name: value.numpy() if isinstance(value, Tensor) else value for name, value in known.items()}
        pictures = np.split(known.pop("pictures"), np.cumsum(known.pop("lengths"))[:-1])
        described = Described(*(known.pop(field.name) for field in fields(Described)))
        return FrameMap([picture.tobytes() for picture in pictures], described=described, **known)
    except FileNotFoundError:
        raise MapError(f"{file}: there is no such map") from None
    except MapError:
        raise
    except RunError as error:
        raise MapError(f"{error}; make it anew with dirl map") from None
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise MapError(f"{file}: is no map of dirl ({type(error).__name__}: {error})") from None


def check_memory(frames: int, every: float) -> None:
    """Refuse a recording whose map would not fit into the memory that is free.

    Raises:
        MapError: it does not; says which ``every`` would do.
    """
    free = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    needed = BYTES * frames
    if needed > free:
        raise MapError(
            f"{frames} frames need {needed / 1e9:.1f} GB, and {free / 1e9:.1f} GB are free: "
            f"every={1.1 * every * needed / free:.2g} or a shorter recording would do"
        )


def map_recordings(
    recordings: Sequence[Iterable[tuple[NDArray[np.uint8], float, tuple[float, float, float] | None]]],
    matcher: FrameMatcher,
    field_of_view: float,
    expected: int = 0,
    progress: bool = False,
) -> FrameMap:
    """Make a map of recordings, without links, one frame in memory at a time.

    Args:
        recordings: each of frames, RGB, uint8 ``[H, W, 3]``, with their times in seconds and odometry, or None.
        matcher: describes the frames.
        field_of_view: of the camera from left to right, degrees.
        expected: frames altogether, about; for the bar.
        progress: show a bar with the time that is left.

    Raises:
        MapError: there are fewer than two frames, or they are of different shapes.
    """
    grown: dict[str, bytearray] = defaultdict(bytearray)  # in place, so that a long recording is held once
    last: dict[str, NDArray[Any]] = {}
    rows: list[tuple[bytes, float, int, tuple[float, float, float] | None]] = []
    size = (0, 0)
    with tqdm(total=expected or None, desc="frames", unit="", disable=None if progress else True) as bar:
        for part, recording in enumerate(recordings):
            for image, time, place in recording:
                if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
                    raise MapError(f"frames: expected RGB, uint8 [H, W, 3], not {image.dtype} {list(image.shape)}")
                height, width = size = size if rows else (image.shape[0], image.shape[1])
                if image.shape[:2] != size:
                    raise MapError(
                        f"recording {part + 1}: {image.shape[1]}x{image.shape[0]} pixels, not {width}x{height}"
                    )
                last = matcher.describe([image]).arrays
                for name, array in last.items():
                    grown[name] += array.tobytes()
                small = Image.fromarray(image)
                small.thumbnail((PICTURE, PICTURE))
                rows.append((encode(np.asarray(small), quality=70, method=2), time, part, place))
                bar.update()
    if len(rows) < 2:
        raise MapError(f"the recording has {len(rows)} frames to keep; at least two are needed")
    pictures, times, parts, places = zip(*rows, strict=True)
    known = [place for place in places if place is not None]
    described = {
        name: np.ndarray((len(rows), *array.shape[1:]), array.dtype, grown[name]) for name, array in last.items()
    }
    return FrameMap(
        list(pictures),
        np.array(times, float),
        np.array(parts),
        Described(**described),
        np.zeros((0, 2), np.int64),
        field_of_view,
        matcher.kind,
        size,
        # Odometry may begin later than the pictures.
        np.array([place or known[0] for place in places]) if known else None,
    )


def find_links(graph: FrameMap, matcher: FrameMatcher, *, progress: bool = False) -> FrameMap:
    """Return the map with its links: pairs of frames of one place, seen at different times or in different recordings.

    Frames of every half second are compared, each with those that are most alike as a whole. Two are linked if so many
    of their points agree, more than with any other place, and those of the frames before or after, too: places that
    only look alike seldom do so for long. Nor may the moves from one frame to the other lead elsewhere.
    """
    scale = graph.scale
    some = np.arange(0, len(graph), max(1, round(EVERY / graph.spacing)))
    times, parts = graph.times[some], graph.parts[some]
    agreeing, cost = _compare(graph, matcher, some, progress)
    leads_back = (lambda *_: True) if scale.tells_places else _course(graph, matcher, some)
    bounded = np.append(parts, [-1, -1])  # so that nothing is before the first frame or after the last one

    def supported(one: int, two: int) -> bool:
        """Return True if the frames around agree, too, walked in the same direction or in the other."""
        for direction in (1, -1):
            around = [
                (one + direction * step, two + step)
                for step in (-2, -1, 1, 2)
                if bounded[one + direction * step] == parts[one] and bounded[two + step] == parts[two]
            ]
            if scale.tells_places:  # none of these scores is much larger than others, so that their mean tells more
                total = agreeing[one][two] + sum(agreeing[first].get(second, 0) for first, second in around)
                if len(around) == 4 and total >= 5 * scale.link:
                    return True
                continue
            seen = [max(agreeing[first].get(second + off, 0) for off in (-1, 0, 1)) for first, second in around]
            # At the ends of a recording there are fewer.
            if len(around) > 1 and sum(value >= scale.link / 2 for value in seen) >= min(3, len(around)):
                return True
        return False

    def distinct(one: int, two: int) -> bool:
        """Return True if the second frame agrees less with any other place than that of the first."""
        near = (np.abs(times - times[one]) <= APART) & (parts == parts[one])
        others = [score for other, score in agreeing[two].items() if not near[other]]
        return agreeing[one][two] >= scale.distinct * max(others, default=0)

    links: list[tuple[int, int]] = []
    linked: dict[int, list[int]] = defaultdict(list)
    candidates = [(one, two) for one, two in cost if agreeing[one][two] >= scale.link]
    for one, two in sorted(candidates, key=lambda pair: -agreeing[pair[0]][pair[1]]):  # the best first
        # Of frames that see each other from afar only the nearest pair is linked, where points do not tell how far.
        beside = any(abs(other - two) <= WINDOW for other in linked[one])
        beside |= any(abs(other - one) <= WINDOW for other in linked[two])
        if beside and not scale.tells_places:
            continue
        if distinct(one, two) and distinct(two, one) and supported(one, two) and leads_back(one, two):
            links.append((one, two))
            linked[one].append(two)
            linked[two].append(one)
    links.sort()
    linked_frames = some[np.array(links, np.int64).reshape(-1, 2)]
    return replace(graph, links=linked_frames, costs=np.array([cost[pair] for pair in links]))


def _compare(
    graph: FrameMap, matcher: FrameMatcher, some: NDArray[np.int64], progress: bool
) -> tuple[dict[int, dict[int, float]], dict[tuple[int, int], float]]:
    """Return how many points of some frames agree, by their numbers in both orders, and what a link of two would cost.

    Pairs that were taken too far from one another have no cost.
    """
    scale, times, parts = graph.scale, graph.times[some], graph.parts[some]
    agreeing: dict[int, dict[int, float]] = defaultdict(dict)
    cost: dict[tuple[int, int], float] = {}
    for row in tqdm(range(1, len(some)), desc="links", unit="", disable=None if progress else True):
        seen = graph.described[some[row] : some[row] + 1]
        apart = np.flatnonzero((times[row] - times[:row] > APART) | (parts[row] != parts[:row]))
        if len(apart) > scale.shortlist:
            likeness = matcher.likeness(seen, graph.described)[some[apart]]
            apart = apart[np.argsort(-likeness)[: scale.shortlist]]
        fit = matcher.fit(seen, graph.described, some[apart].tolist())
        distance, turn = np.hypot(fit.ahead, fit.right), np.abs(fit.turned)
        costs = 1 + distance / STRIDE + turn / TURN
        near = (distance < NEAR) & (turn < TURNED)
        for other, score, value, is_near in zip(apart.tolist(), fit.score.tolist(), costs.tolist(), near, strict=True):
            agreeing[row][other] = agreeing[other][row] = score
            if is_near:
                cost[other, row] = value
    return agreeing, cost


def _course(graph: FrameMap, matcher: FrameMatcher, some: NDArray[np.int64]) -> Callable[[int, int], bool]:
    """Return what is False for two of some frames if the moves from one to the other lead elsewhere.

    Moves between successive frames add up, with a drift: every one that is no turn on the spot is a step ahead.
    """
    moves = [graph.motion(matcher, one, two) for one, two in pairwise(some.tolist())]
    turned = np.array([0.0 if move is None else move.turned for move in moves])
    steps = np.array([move is not None and not move.on_the_spot and abs(move.turned) < TURNS for move in moves])
    gaps = np.array([move is None for move in moves]) | (np.diff(graph.parts[some]) != 0)
    heading, walked, unknown = (np.append(0, np.cumsum(part)) for part in (turned, steps, gaps))
    place = np.append(0, np.cumsum(steps * np.exp(1j * np.radians(heading[:-1] + turned / 2))))

    def leads_back(one: int, two: int) -> bool:
        if unknown[one] != unknown[two]:
            return True
        motion = graph.motion(matcher, some[one], some[two])
        if motion is None:
            return True
        off = abs((heading[two] - heading[one] - motion.turned + 180) % 360 - 180)
        far = ASTRAY[0] + ASTRAY[1] * (walked[two] - walked[one])
        return bool(off <= DRIFT[0] + DRIFT[1] * (two - one) and abs(place[two] - place[one]) <= far)

    return leads_back


def load_matcher(kind: str | None) -> FrameMatcher:
    """Return what describes and compares frames: by points of photographs (`Matcher`), or by ``columns`` of walls."""
    return load_column_net() if kind == "columns" else Matcher(kind)
