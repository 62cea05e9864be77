"""Being led to a photo, live: camera frames in, what to do next out."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from dirl.agent.mapping.belief import Belief
from dirl.agent.mapping.frames import FrameMap
from dirl.agent.mapping.graph import MapError
from dirl.perception.matching import Described, Matcher

COMPARED = 8
"""Frames whose points are compared with what is seen, each time: the most likely ones."""

LIKE, POINTS = 4.0, 10.0
"""A cosine of 1 multiplies the likelihood by exp(LIKE); so many points that agree make it four times as large."""

SURE = 0.5
"""Least probability around a frame; below it one is lost."""

AHEAD = 5
"""Frames along the path that are looked for, the farthest first."""

AGREE = {"xfeat": 20.0, "sift": 10.0, "none": 0.0}
"""Points that agree with a frame that is recognised."""

NEARLY = 0.45
"""Of the points of the path's best frame, what suffices for a farther one to lead."""

ARRIVED = 0.35
"""Of the points of the photo that agree with the map's frame at the goal, what must agree with the view there."""

PATIENCE = 2
"""Views in a row without any frame that is recognised, before one is lost."""

STRAIGHT = 12.0
"""Degrees that are not worth a turn."""

NEAR = 2
"""Links to the goal, at most, where one may have arrived."""


class Guidance(NamedTuple):
    """What to do next."""

    say: Literal["turn", "ahead", "arrived", "lost"]
    turn: float
    """Degrees to the left; negative to the right, 0 unless it is a turn."""
    frame: int
    """Of the map, where one seems to be."""
    sure: float
    """How likely that is, with the frames around."""

    def __str__(self) -> str:
        if self.say != "turn":
            return self.say
        return f"turn {'left' if self.turn > 0 else 'right'} by {abs(self.turn):.0f} degrees"


class Guide:
    """Leads to where a photo was taken: call `see` with each frame of the camera, about as often as the map has frames.

    A filter over the frames of the map says where one is: a single view can be of many places, a row of them seldom.

    Args:
        graph: a map of recordings of the same kind of camera, held in the same way.
        photos: of the goal, RGB, uint8 ``[H, W, 3]``; several in a row find it more surely.
        matcher: of the map's kind; made if left out.

    Raises:
        MapError: the photos were not taken where the map was recorded.

    Example:
        ::

            guide = dirl.Guide(load_frames_map("walk.npz"), [photo])
            for frame in camera:
                print(guide.see(frame))
    """

    def __init__(self, graph: FrameMap, photos: Sequence[NDArray[np.uint8]], matcher: Matcher | None = None) -> None:
        self.graph = graph
        self.matcher = matcher or Matcher(graph.kind)
        found = graph.find(self.matcher, self.matcher.describe(self._fitted(photo) for photo in photos))
        if found.answer == "not here":
            raise MapError("the photo was not taken where the map was recorded")
        self.goal = found.frame
        self._photo = self.matcher.describe([self._fitted(photos[len(photos) // 2])])
        self._least = AGREE[graph.kind]
        self._arrived = max(self._least, ARRIVED * self._agreeing(self._photo, graph.described, self.goal))
        self._missed = PATIENCE
        self._steps: dict[int, float] = {}
        self._far, self._following = graph.distances_to(np.array([self.goal]))
        self.belief = Belief(len(graph), graph.links)

    def see(self, frame: NDArray[np.uint8]) -> Guidance:
        """Say what to do where a frame is seen, RGB, uint8 ``[H, W, 3]``."""
        seen = self.matcher.describe([self._fitted(frame)])
        self.belief.move()
        likelihood = np.exp(LIKE * self.graph.whitening.likeness(seen.looks)[0].astype(float))
        if self.matcher.kind != "none":
            some = np.argsort(-self.belief.of * likelihood)[:COMPARED]
            agreeing = self.matcher.agreements(seen, self.graph.described, some.tolist())
            likelihood[some] *= (1 + agreeing / POINTS) ** 2
        self.belief.weigh(likelihood)
        here, sure = self.belief.frame()
        if sure < SURE or not np.isfinite(self._far[here]):
            return Guidance("lost", 0.0, here, sure)
        if self._far[here] <= NEAR and self._agreeing(seen, self._photo, 0) >= self._arrived:
            return Guidance("arrived", 0.0, here, sure)
        turn = self._turn(seen, here)
        self._missed = self._missed + 1 if turn is None else 0
        if self._missed >= PATIENCE:
            return Guidance("lost", 0.0, here, sure)
        turn = turn or 0.0
        return Guidance("turn" if turn else "ahead", turn, here, sure)

    def _turn(self, seen: Described, here: int) -> float | None:
        """Degrees to the left to the heading of the farthest frame of the path that is recognised; None if none is."""
        path, turning = [here], False
        while len(path) <= AHEAD and self._far[path[-1]] > 0:
            step = self._step(path[-1])
            if abs(step) >= STRAIGHT and len(path) > 1 and not turning:
                break  # the corner is seen from afar, but one walks up to it first
            turning = abs(step) >= STRAIGHT
            path.append(int(self._following[path[-1]]))
        matches = [self.matcher.match(seen, self.graph.described, frame) for frame in path]
        agreeing = np.array([self.matcher.agreeing(one) for one in matches])
        if agreeing.max() < self._least:
            return None
        leading = int(np.flatnonzero(agreeing >= max(self._least, NEARLY * agreeing.max())).max())
        turn = self.matcher.turn_between(matches[leading], self.graph.size, self.graph.field_of_view) or 0.0
        return turn if abs(turn) >= STRAIGHT else 0.0

    def _step(self, frame: int) -> float:
        """Degrees to the left from a frame to the next one of the path."""
        if frame not in self._steps:
            one, following = self.graph.described[frame : frame + 1], int(self._following[frame])
            matches = self.matcher.match(one, self.graph.described, following)
            turn = self.matcher.turn_between(matches, self.graph.size, self.graph.field_of_view)
            self._steps[frame] = turn or 0.0
        return self._steps[frame]

    def _agreeing(self, seen: Described, others: Described, view: int) -> float:
        return self.matcher.agreeing(self.matcher.match(seen, others, view))

    def _fitted(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """An image of the size of the map's frames; what is wider or taller is cut off."""
        height, width = self.graph.size
        scale = max(height / image.shape[0], width / image.shape[1])
        size = max(width, round(image.shape[1] * scale)), max(height, round(image.shape[0] * scale))
        resized = np.asarray(Image.fromarray(image).resize(size, Image.Resampling.BOX if scale < 1 else None))
        top, left = (size[1] - height) // 2, (size[0] - width) // 2
        return resized[top : top + height, left : left + width]
