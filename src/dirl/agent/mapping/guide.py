"""Being led to a photo by a recorded walk: frames of a camera in, what to do next out. Turns may be of any angle.

As SPTM (Savinov et al., ICLR 2018): the frames of the walk are a graph, in which links join frames of one place; one is
localised in it, and led to the farthest frame of the path that is in sight. Here a filter over time localises, and the
points of two frames tell how far one has to turn, and in a game how far one has to go. Photographs and games differ in
what compares frames (`dirl.perception.matching.FrameMatcher`), and in nothing else.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps
from scipy.sparse.csgraph import dijkstra

from dirl.agent.mapping.frames import FrameMap, load_matcher
from dirl.agent.mapping.image_graph import MapError
from dirl.perception.matching import Described, Fit, FrameMatcher, Motion

MOVES = (0.08, 0.15, 0.25, 0.2, 0.15, 0.1, 0.07)
"""How likely one is 2 frames before, ..., 4 frames after the last one."""

ELSEWHERE, LINKED = 0.03, 0.3
"""How likely one is anywhere, and at the other end of a link."""

AROUND = 3
"""Frames before and after that count as one place."""

LIKE, COMPARED = 4.0, 8
"""A likeness of 1 multiplies the likelihood of a frame by exp(LIKE); of so many likely ones points are compared."""

SURE = 0.3
"""Least probability around a frame; below it one is lost."""

ON_THE_WAY = 1.3
"""Seconds of the path that are looked for at most, the farthest frame first; and `AHEAD` frames at least."""

AHEAD = 5

NEARLY = 0.45
"""Of the points of the path's best frame, what suffices for a farther one to lead."""

ARRIVED, NEAR = 0.35, 2.0
"""Of the points of the photo that agree with the map's frame at the goal, what must agree with the view; and how far,
by the path, one may be from that frame."""

MISSED = 2
"""Views in a row in which no frame of the path is in sight, before one is lost."""

STRAIGHT = 12.0
"""Degrees that are not worth a turn."""

BEYOND = 60.0
"""Units from which a frame is walked to; nearer ones tell by their heading where the path goes on."""

ASIDE = 70.0
"""Degrees from which another heading has nothing in common with the present one; then points only seem to agree."""

PATIENCE, PAUSE = 4, 2
"""Views without progress before another path is taken, for each frame of the path that is looked for; and before one
does what the recording did next, though nothing of it is in sight."""

FORGOTTEN = 0.3
"""Of what is known of where one is, what is given up by whoever has to wander about."""

EVERYWHERE = 12
"""Of so many views one is compared with frames where one is unlikely to be."""

IN_VAIN = 8.0
"""What a link of the path costs more, each time that it did not lead on."""


class Guidance(NamedTuple):
    """What to do next."""

    say: Literal["turn", "ahead", "back", "arrived", "lost", "stuck"]
    """``back`` is to walk backwards; ``stuck`` that no progress was made for long, and another path is tried."""
    turn: float
    """Degrees to the left; negative to the right."""
    frame: int
    """Of the map, where one seems to be."""
    sure: float
    """How likely that is, with the frames around."""
    ahead: float = 0.0
    """Units to where the frame that leads was taken, where points tell that."""
    right: float = 0.0
    """Likewise, to the right."""
    backwards: bool = False
    """True if the path follows the recording back in time: the camera looks to where one comes from."""
    to_photo: bool = False
    """True if the photo itself is in sight and leads."""

    def __str__(self) -> str:
        if self.say != "turn":
            return self.say
        return f"turn {'left' if self.turn > 0 else 'right'} by {abs(self.turn):.0f} degrees"


def spread(belief: NDArray[np.float64], links: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the probabilities of the frames, ``[N]``, after a walk on, or along a link, or anywhere."""
    moved = np.convolve(belief, MOVES)[2 : 2 + len(belief)]
    for one, other in (links.T, links.T[::-1]):
        np.maximum.at(moved, other, LINKED * belief[one])
    return (1 - ELSEWHERE) * moved / moved.sum() + ELSEWHERE / len(belief)


def present(belief: NDArray[np.float64]) -> tuple[int, float]:
    """Return the present frame by the probabilities of the frames, ``[N]``, and how likely one is around it."""
    around = int(np.convolve(belief, np.ones(2 * AROUND + 1), "same").argmax())
    first = max(0, around - AROUND)
    frame = first + int(belief[first : around + AROUND + 1].argmax())
    return frame, float(belief[max(0, frame - 8) : frame + 9].sum())


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

            guide = dirl.Guide(load_frames_map("walk.pt"), [photo])
            for frame in camera:
                print(guide.see(frame))
    """

    def __init__(
        self, graph: FrameMap, photos: Sequence[NDArray[np.uint8]], matcher: FrameMatcher | None = None
    ) -> None:
        self.graph = graph
        self.matcher = matcher or load_matcher(graph.kind)
        answer = graph.find(self.matcher, self.matcher.describe(self._fitted(photo) for photo in photos))
        if answer.answer == "not here":
            raise MapError("the photo was not taken where the map was recorded")
        self._scores = answer.scores.copy()
        self._photo = self.matcher.describe([self._fitted(photos[len(photos) // 2])])
        self._links = graph.graph.copy()
        self.belief = np.full(len(graph), 1 / len(graph))
        self._window = max(AHEAD, round(ON_THE_WAY / graph.spacing))
        self._steps: dict[tuple[int, int], float] = {}
        self._missed = MISSED
        self._views = 0
        self._since, self._least = 0, float("inf")  # views without progress, and the least way to the goal so far
        self._followed: list[int] = []
        self._arrived = 1.0  # least agreement with the photo
        self._plan()

    def see(self, frame: NDArray[np.uint8]) -> Guidance:
        """Say what to do where a frame is seen, RGB, uint8 ``[H, W, 3]``."""
        seen = self.localise(frame)
        here, sure = present(self.belief)
        if sure < SURE or not np.isfinite(self._far[here]):
            self._missed = MISSED
            return Guidance("lost", 0.0, here, sure)
        path = self._path(here)
        fit = self.matcher.fit(seen, self.graph.described, [*path, *self._followed])
        of_photo = float(self.matcher.fit(seen, self._photo, [0]).score[0]) if self._far[path[-1]] == 0 else 0.0
        best, least = max(float(fit.score[: len(path)].max()), of_photo), self.graph.scale.recognised
        self._missed = self._missed + 1 if best < least else 0
        if best < least:
            return Guidance("lost" if self._missed >= MISSED else "ahead", 0.0, here, sure)
        if self._without_progress(here):
            self._doubt(path)
            return Guidance("stuck", 0.0, here, sure)
        enough = max(least, NEARLY * best)
        arrived = self._far[here] <= NEAR and of_photo >= self._arrived
        if arrived or of_photo >= enough:
            motion = self._motion(seen, self._photo, 0)
            return self._towards(motion, here, sure, "arrived" if arrived else "ahead", to_photo=True)
        path, leading = self._leading(here, path, fit, enough)
        motion = self._motion(seen, self.graph.described, path[leading])
        if leading == 0 and len(path) > 1 and self._since >= PAUSE:  # exactly here nothing else fits as well
            leading, motion = 1, motion._replace(turned=motion.turned + self._next_turn(path))
        backwards = leading > 0 and all(0 <= one - two <= 1 for one, two in pairwise(path[: leading + 1]))
        return self._towards(motion, here, sure, "back" if backwards else "ahead", backwards=backwards)

    def _leading(self, here: int, path: list[int], fit: Fit, enough: float) -> tuple[list[int], int]:
        """Return the path to go, and the index of its frame that leads: the cheapest path from here, or another one.

        The fit is that of the view with this path, and with the one that was followed until now. A frame is in sight
        with a score of ``enough``.
        """
        link = self.graph.scale.link
        scores, before = np.split(fit.score, [len(path)])
        if not self.graph.scale.tells_places:
            # What the recording showed from here leads, wherever one looks: were it what is in sight now, whoever looks
            # aside to where the path turns next would be told to turn on, and others to go ahead.
            shown = self.matcher.fit(self.graph.described[here : here + 1], self.graph.described, path).score
            leading = int(np.flatnonzero(shown >= link).max(initial=0))
            return path, leading if scores[leading] >= self.graph.scale.recognised else int(scores.argmax())
        towards, towards_before = np.split(np.abs(fit.turned) < ASIDE, [len(path)])
        in_sight = np.flatnonzero((scores >= enough) & towards)
        leading = int(in_sight.max() if len(in_sight) else scores.argmax())
        # What was followed leads on while it is in sight: a place was often recorded several times, and who changes
        # over to another of these paths at every view turns to and fro.
        in_sight = np.flatnonzero((before >= min(enough, link)) & towards_before)
        if len(in_sight) and self._far[self._followed[in_sight.max()]] < self._far[path[leading]]:
            path, leading = self._followed, int(in_sight.max())
        self._followed = path
        return path, leading

    def localise(self, frame: NDArray[np.uint8]) -> Described:
        """Take in a frame while nobody asks what to do: moves spread the belief, and what is seen weighs it."""
        seen = self.matcher.describe([self._fitted(frame)])
        self.belief = spread(self.belief, self.graph.links)
        # Else all recordings of a place would be as likely as the one that is followed, and paths change at every view.
        everywhere = self._views % (EVERYWHERE if self._missed < MISSED else 3) == 0
        self._views += 1
        likely = None if everywhere else self.belief
        likelihood = np.exp(LIKE * self.matcher.likeness(seen, self.graph.described, likely))
        if np.isfinite(self.graph.scale.unit):
            some = np.argsort(-self.belief * likelihood)[:COMPARED]
            agreeing = self.matcher.fit(seen, self.graph.described, some.tolist()).score
            likelihood[some] *= (1 + agreeing / self.graph.scale.unit) ** 2
        belief = self.belief * likelihood
        self.belief = belief / belief.sum()
        return seen

    def forget(self) -> None:
        """Doubt where one is and how far one came, as somebody must who has to wander about."""
        self.belief = (1 - FORGOTTEN) * self.belief + FORGOTTEN / len(self.graph)
        self._since, self._least = 0, float("inf")

    def _path(self, here: int) -> list[int]:
        """Return the next frames of the path, those that may be in sight."""
        path, turning = [here], False
        while len(path) <= self._window and self._far[path[-1]] > 0:
            following = int(self._following[path[-1]])
            if not self.graph.scale.tells_places:
                corner = abs(self._step(path[-1], following)) >= STRAIGHT
                if corner and len(path) > 1 and not turning:
                    break  # the corner is seen from afar, but one walks up to it first
                turning = corner
            path.append(following)
        return path

    def _step(self, frame: int, following: int) -> float:
        """Return degrees to the left from a frame to the next one of the path."""
        if (frame, following) not in self._steps:
            motion = self.graph.motion(self.matcher, frame, following)
            self._steps[frame, following] = 0.0 if motion is None else motion.turned
        return self._steps[frame, following]

    def _next_turn(self, path: list[int]) -> float:
        """Return degrees to the left from the first frame of a path to the end of the turn that follows."""
        turn = 0.0
        for first, second in pairwise(path):
            step = self._step(first, second)
            turn += step
            if abs(step) < STRAIGHT:
                break
        return turn

    def _towards(
        self, motion: Motion, here: int, sure: float, straight: Literal["ahead", "back", "arrived"], **facts: bool
    ) -> Guidance:
        """Say what leads along a motion: a turn, or what is to be done straight on."""
        turn = motion.turned
        if motion.ahead > BEYOND:  # half to the heading of the frame, and half to where it was taken
            turn = (turn - float(np.degrees(np.arctan2(motion.right, motion.ahead)))) / 2
        say = "turn" if abs(turn) >= STRAIGHT and straight != "arrived" else straight
        return Guidance(say, turn, here, sure, motion.ahead, motion.right, **facts)

    def _without_progress(self, here: int) -> bool:
        """Return True if for many views one came no nearer."""
        self._since = 0 if self._far[here] < self._least - 0.5 else self._since + 1
        self._least = min(self._least, float(self._far[here]))
        return self._since > PATIENCE * self._window

    def _doubt(self, path: list[int]) -> None:
        """Make what did not lead on cost more; give up a goal that was reached in vain for the next best."""
        if len(path) < 4:
            self._scores[self.graph.same_place(self.goal)] = -1
        for first, second in pairwise(path[:9]):
            self._links[first, second] += IN_VAIN
        self.forget()
        self._plan()

    def _plan(self) -> None:
        """Choose the goal's frame, and the paths to it."""
        self.goal = int(self._scores.argmax())
        self._far, self._following = dijkstra(self._links.T, indices=self.goal, return_predecessors=True)
        self._followed = []
        agreeing = float(self.matcher.fit(self._photo, self.graph.described, [self.goal]).score[0])
        self._arrived = max(self.graph.scale.recognised, ARRIVED * agreeing)

    def _motion(self, seen: Described, frames: Described, frame: int) -> Motion:
        """Return the motion to a frame; no motion where too few points agree."""
        motion = self.matcher.motion(seen, frames, frame, self.graph.size, self.graph.field_of_view)
        return motion or Motion(0.0, 0.0, 0.0)

    def _fitted(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return an image of the size of the map's frames; what is wider or taller is cut off."""
        height, width = self.graph.size
        if image.shape[:2] == (height, width):
            return image
        return np.asarray(ImageOps.fit(Image.fromarray(image), (width, height), Image.Resampling.BOX))
