"""A scene: one room as a graph of states, each a location and a heading with one camera view."""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from dirl.scenes.errors import SceneError as SceneError  # where all look for it
from dirl.scenes.graph import AHEAD, RIGHT, GraphError, IntArray, check_graph, shortest_distances, turns_per_circle
from dirl.scenes.views import FileViews, Views, check_image

A = TypeVar("A", bound=np.ndarray)

LARGEST = 1e6
"""Metres of a position in a table; what is beyond has been misread."""

BEYOND = 1e9
"""Squares of larger numbers are none in float32."""

MAX_NAME = 100
"""Bytes of UTF-8; a file's name may have 255."""

STORED = {
    "patches": "patches",
    "look_features": "look_feature",
    "look_patches": "look_patches",
    "along": "along_feature",
    "toward": "toward",
}
"""The datasets of what is large of a scene beside its features, by their names in `Scene`."""

ALLOWED = re.compile(r"[^\W_](?:[\w .,()+-]*[\w)+])?")
"""Letters and digits of any script, and what needs no care in paths, in matplotlib's titles and in Hydra's options."""


@dataclass(frozen=True, eq=False, repr=False)
class Scene:
    """One room. Immutable (its arrays are read-only) and checked when made.

    Args:
        name: e.g. ``bathroom_02``.
        graph: next states, integers ``[N, 4]`` in the order of `ACTIONS`, -1 = blocked.
        positions: metres, ``[N, 2]``: x, z of each state's location.
        headings: degrees clockwise, ``[N]``.
        features: the frozen backbone's output for each state's view, float16 or float32 ``[N, D]``; None if the
            views have not been encoded yet.
        views: the camera images, or None.
        goals: the goal states that come with the scene; may be empty.
        source: its origin: ``rooms`` (built in), ``synthetic`` (generated) or ``thor``.
        extractor: what made the features; scenes with different extractors cannot share a `World`.
        origin: the file or function that made it, named in errors.
        patches: features of the parts of each view (`dirl.perception.backbones.patches`), float16 ``[N, cells,
            channels]``, or None; those of a scene that was read from a file are memory-mapped.
        look_features: of further looks, what a state looks like at other visits, float16 or float32 ``[K, N, D]``; or
            None.
        look_patches: likewise, float16 ``[K, N, cells, channels]``; there if both ``patches`` and looks are.
        along: features of what is seen along the arrow that a move ahead follows, float16 ``[N, D]``, zero where there
            is none; or None. An arrow of a tour may lie aside of the heading that shows it.
        toward: how clearly that arrow leads to each state, 0 to 1, if the four views around it are known, or the one
            ahead alone, float16 ``[2, N, N]``; or None. See `dirl.perception.bearings`.

    Raises:
        SceneError: an array has the wrong shape or type, or the first offending state of it is named.
    """

    name: str
    graph: IntArray
    positions: NDArray[np.floating]
    headings: NDArray[np.floating]
    features: NDArray[np.floating] | None = None
    views: Views | None = None
    goals: tuple[int, ...] = ()
    source: str = "synthetic"
    extractor: str = "unknown"
    origin: str = "a scene made in memory"
    patches: NDArray[np.float16] | None = None
    look_features: NDArray[np.floating] | None = None
    look_patches: NDArray[np.float16] | None = None
    along: NDArray[np.float16] | None = None
    toward: NDArray[np.float16] | None = None

    def __post_init__(self) -> None:
        check_name(self.name, self.origin)
        given = self._array("graph", self.graph, np.integer, (None, 4))
        # The largest unsigned numbers would become -1, a blocked move.
        graph = np.minimum(given, min(np.iinfo(given.dtype).max, np.iinfo(np.int64).max)).astype(np.int64)
        states = len(graph)
        try:
            check_graph(graph)
        except GraphError as error:
            raise SceneError(f"{self.origin}: graph: {error}") from None
        positions = self._array("location", self.positions, np.number, (states, 2)).astype(np.float64)
        headings = self._array("rotation", self.headings, np.number, (states,)).astype(np.float64)
        arrays: dict[str, np.ndarray] = {"graph": graph, "positions": positions, "headings": headings}
        if self.features is not None:
            features = np.asarray(self.features)
            if np.issubdtype(features.dtype, np.floating):
                with np.errstate(over="ignore"):  # what overflows is found by the check for finite values
                    kind = np.float16 if features.dtype == np.float16 else np.float32
                    features = features.astype(kind, copy=features.flags.writeable)  # else as they are, mapped
            arrays["features"] = self._array("resnet_feature", features, np.floating, (states, None))
        width = 0 if self.features is None else self.features.shape[1]
        looks = None if self.look_features is None else len(self.look_features)
        parts = (None, None) if self.patches is None else self.patches.shape[1:]
        shapes: dict[str, tuple[type, tuple[int | None, ...]]] = {
            "patches": (np.float16, (states, None, None)),
            "look_features": (np.floating, (None, states, width)),
            "look_patches": (np.float16, (looks, states, *parts)),
            "along": (np.float16, (states, width)),
            "toward": (np.float16, (2, states, states)),
        }
        for name, expected in shapes.items():
            if getattr(self, name) is not None:
                arrays[name] = self._array(STORED[name], getattr(self, name), *expected)
        turned = np.where(graph[:, RIGHT] < 0, np.arange(states), graph[:, RIGHT])
        moved = np.flatnonzero((np.abs(positions[turned] - positions) > 1e-3).any(1))
        if len(moved):
            state = moved[0]
            raise SceneError(
                f"{self.origin}: location: state {state} is at {positions[state].tolist()} but the state to its right, "
                f"{turned[state]}, is at {positions[turned[state]].tolist()}; a turn must not move the agent"
            )
        if self.views is not None and len(self.views) != states:
            raise SceneError(f"{self.origin}: {len(self.views)} views for {states} states")
        if self.views is not None and not isinstance(self.views, FileViews):  # a file's are checked when they are read
            check_image(np.asarray(self.views[0]), f"{self.origin}: views[0]")
        for name, array in arrays.items():
            object.__setattr__(self, name, _read_only(array))
        self.check_goals(self.goals)

    def __repr__(self) -> str:
        features = "no features" if self.features is None else f"features [{', '.join(map(str, self.features.shape))}]"
        shown = f"{len(self)} states, {len(self.goals)} goals, {features}, {self.looks} look{'s'[: self.looks > 1]}"
        return f"<Scene {self.name} ({self.source}): {shown}, from {self.origin}>"

    def __len__(self) -> int:
        """Return the number of states."""
        return len(self.graph)

    @property
    def looks(self) -> int:
        """How many looks a state has, the default one among them."""
        return 1 if self.look_features is None else 1 + len(self.look_features)

    @cached_property
    def distances(self) -> NDArray[np.int32]:
        """Fewest actions from each state (row) to each state (column), int32 ``[N, N]``, -1 = unreachable."""
        return _read_only(shortest_distances(self.graph))

    @cached_property
    def surrounding(self) -> IntArray:
        """The states seen ahead, to the right, behind and to the left of each heading, int64 ``[N, 4]``.

        They are found by repeated turns along the graph's own links, never from the numbering of the states (paper
        section 3.5). Column 0 is the state itself, and a state without moves sees itself four times.
        """
        states = np.arange(len(self))
        right = np.where(self.graph[:, RIGHT] >= 0, self.graph[:, RIGHT], states)
        quarter = states
        for _ in range(turns_per_circle(self.graph) // 4):
            quarter = right[quarter]
        return _read_only(np.stack([states, quarter, quarter[quarter], quarter[quarter[quarter]]], 1))

    @cached_property
    def step_length(self) -> float:
        """Return the median length of the moves ahead, metres; 0.5 where there are none."""
        states = np.flatnonzero(self.graph[:, AHEAD] >= 0)
        moves = self.positions[self.graph[states, AHEAD]] - self.positions[states]
        return float(np.median(np.hypot(*moves.T))) if len(moves) else 0.5

    @cached_property
    def directions(self) -> NDArray[np.float64]:
        """Where each state's heading points to on the map: unit vectors (x, z), float64 ``[N, 2]``.

        Headings are clockwise from +z in AI2-THOR, but other files may differ. The sense of rotation and its zero are
        therefore those that agree best with the moves ahead; where the moves leave it open, those of AI2-THOR.
        """
        states = np.flatnonzero(self.graph[:, AHEAD] >= 0)
        x, z = (self.positions[self.graph[states, AHEAD]] - self.positions[states]).T
        moves = z + 1j * x  # whose angle is the clockwise one from +z
        clockwise = np.exp(1j * np.deg2rad(self.headings))
        turned, zero = clockwise, np.complex128(1)
        if len(moves):
            # Where a sense fits, every move asks for the same zero; where it does not, they cancel each other out.
            fits = [(sense, np.mean(moves / sense[states])) for sense in (clockwise, clockwise.conj())]
            best, mean = max(fits, key=lambda fit: round(abs(fit[1]), 6))
            # With headings that are all the same the moves may cancel out in either sense.
            if abs(mean) > 1e-6 * np.abs(moves).max():
                turned, zero = best, mean / abs(mean)
        pointing = turned * zero
        return _read_only(np.stack([pointing.imag, pointing.real], 1))

    def check_goals(self, goals: Iterable[int]) -> None:
        """Raise `SceneError` unless each goal is a state that some other state can reach."""
        start, action = np.nonzero((self.graph >= 0) & (self.graph != np.arange(len(self))[:, None]))
        entered = np.zeros(len(self), bool)  # by a move from another state
        entered[self.graph[start, action]] = True
        for goal in goals:
            if isinstance(goal, bool) or not isinstance(goal, int | np.integer):
                raise SceneError(f"{self.origin}: goal {goal!r} is not a state; states are integers")
            if not 0 <= goal < len(self):
                raise SceneError(f"{self.origin}: goal {goal} is not a state; states are 0..{len(self) - 1}")
            if not entered[goal]:
                raise SceneError(f"{self.origin}: goal {goal} cannot be reached from any other state")

    def _array(self, name: str, value: object, kind: type, shape: tuple[int | None, ...]) -> np.ndarray:
        array = np.asarray(value)
        if not np.issubdtype(array.dtype, kind):
            raise SceneError(f"{self.origin}: {name}: expected {kind.__name__} values, found {array.dtype}")
        fits = array.ndim == len(shape) and all(
            want is None or have == want for have, want in zip(array.shape, shape, strict=True)
        )
        if not fits:
            wanted = tuple("any" if size is None else size for size in shape)
            raise SceneError(f"{self.origin}: {name}: expected shape {wanted}, found {array.shape}")
        if np.issubdtype(array.dtype, np.inexact):
            flat = array.reshape(len(array), -1)
            most = np.maximum(flat.max(1, initial=0), -flat.min(1, initial=0)).astype(np.float64)
            rows = np.flatnonzero(~(most < BEYOND))  # NaN is not less either
            if len(rows):
                state = f"{self.origin}: {name}: state {rows[0]}"
                raise SceneError(f"{state} holds a value that is not finite, or beyond {BEYOND:g}")
        return array


def check_name(name: str, origin: str) -> None:
    """Raise `SceneError` unless a scene can have that name; ``origin`` is its source, for errors.

    A network stores layers under the names of scenes, so names of a module's own attributes (``keys``) are excluded.
    """
    from torch import nn  # here, because the process that reads dumps does without torch

    if not ALLOWED.fullmatch(name) or len(name.encode()) > MAX_NAME:
        shown = name if len(name) <= 60 else f"{name[:60]}..."
        raise SceneError(
            f"{origin}: a scene cannot be called {shown!r}; a name has 1 to {MAX_NAME} letters, digits, spaces, and "
            "any of _.,()+- after the first"
        )
    if hasattr(nn.ModuleDict(), name.replace(".", "_")):
        raise SceneError(
            f"{origin}: a scene cannot be called {name!r}, which is a word of the network's own; choose another name"
        )


def _read_only(array: A) -> A:
    array.setflags(write=False)
    return array
