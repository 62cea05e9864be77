"""Being led to a photo by a recorded walk: a camera ahead, turns of any angle, nothing but frames.

As SPTM (Savinov et al., ICLR 2018): the frames of the walk are a graph, in which shortcuts join frames of one place; an
agent localises itself in it, looks for the farthest frame of the path that it still recognises, and moves towards that.
Here a filter over time localises, and `ColumnNet` tells by which motion a frame is reached.
"""

from itertools import pairwise

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from tensordict import TensorDict

from dirl.agent.mapping.belief import Belief
from dirl.agent.mapping.columns import ColumnNet

AHEAD, BACK, LEFT, RIGHT, IDLE, TURN_LEFT, TURN_RIGHT = range(7)
BUTTONS = ("MOVE_FORWARD", "MOVE_BACKWARD", "MOVE_LEFT", "MOVE_RIGHT", None, "TURN_LEFT", "TURN_RIGHT")
"""Of Doom, for each action."""

STEP, WINDOW = 5, 2
"""One of so many frames is compared with all for shortcuts; so many before and after must fit too."""

APART, ALIKE = 20, 0.9
"""Frames between the ends of a shortcut, at least, and the mean score of the window."""

NEAR, TURNED = 90, 35
"""Units and degrees between the ends of a shortcut, at most."""

BACKWARDS = 2.0
"""What going back by one frame costs; going on costs 1."""

EVIDENCE, LEAST = 1.56, 0.15
"""The likelihood of a frame is (likeness + LEAST) ** EVIDENCE."""

LOOKED, ALL = 60, 12
"""So many likely frames are compared with what is seen; every so many actions all."""

SURE, SEEN = 0.3, 0.25
"""Least probability around a frame, and least score of one on the path, to go on."""

ON_THE_WAY, NEARLY = 12, 0.45
"""Frames of the path that are looked for, and which part of the best score suffices."""

CIRCLE, PATIENCE = 15, 45
"""Turns before one gives up looking around, and actions without progress."""

IN_VAIN = 8.0
"""What a link of the path costs more, each time that it did not lead on."""

SAME_PLACE = 30
"""Frames around a goal in vain that are not tried again."""

SAME_VIEW = 1.5
"""Mean difference of grey values between frames, when a move was stopped by a wall."""


class Memory:
    """A recorded walk as a graph.

    Args:
        net: compares frames.
        frames: RGB, uint8 ``[N, H, W, 3]``, in order of time, 90 degrees from left to right.
    """

    def __init__(self, net: ColumnNet, frames: NDArray[np.uint8]) -> None:
        self.net, self.frames = net, frames
        self.columns = net.describe(frames)
        self.shortcuts, costs = self._find_shortcuts()
        count = len(frames)
        now, next_ = np.arange(count - 1), np.arange(1, count)
        one, two = self.shortcuts.T
        first, second = np.concatenate([now, next_, one, two]), np.concatenate([next_, now, two, one])
        cost = np.concatenate([np.ones(count - 1), np.full(count - 1, BACKWARDS), costs, costs])
        self.links = csr_array((cost, (first, second)), shape=(count, count))

    def _find_shortcuts(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Pairs of frames, int ``[S, 2]``, and what going from one to the other costs."""
        some = np.arange(0, len(self.frames), STEP)
        score = np.zeros((len(some), len(some)), np.float32)
        for row, frame in enumerate(some[:-1]):
            fit = self.net.fit(self.columns[frame : frame + 1], self.columns[some[row + 1 :]])
            score[row, row + 1 :] = score[row + 1 :, row] = fit.score
        kernel = torch.eye(2 * WINDOW + 1)[None, None] / (2 * WINDOW + 1)
        smooth = F.conv2d(torch.from_numpy(score)[None, None], kernel, padding=WINDOW)[0, 0].numpy()
        one, two = np.nonzero((smooth > ALIKE) & (score > ALIKE))
        apart = two - one >= APART // STEP
        one, two = some[one[apart]], some[two[apart]]
        if not len(one):
            return np.zeros((0, 2), np.int64), np.zeros(0)
        fit = self.net.fit(self.columns[one], self.columns[two])
        distance, turn = np.hypot(fit.ahead, fit.right), np.abs(fit.turned)
        kept = (distance < NEAR) & (turn < TURNED)
        return np.stack([one, two], 1)[kept], 1 + distance[kept] / 40 + turn[kept] / 28

    def fits(self, photo: TensorDict) -> NDArray[np.float64]:
        """How well each frame and its neighbours fit a photo, ``[N]``; less from far away."""
        fit = self.net.fit(photo, self.columns)
        near = fit.score * np.exp(-np.hypot(fit.ahead, fit.right) / 300)
        return np.convolve(near, np.full(5, 0.2), "same")


class Follower:
    """Walks to a photo by a memory: call `act` with what is seen, until told that the goal is reached.

    Args:
        memory: of the place.
        photo: RGB, uint8 ``[H, W, 3]``.
        seed: of what it does when it is stuck.
    """

    def __init__(self, memory: Memory, photo: NDArray[np.uint8], seed: int = 0) -> None:
        self.memory = memory
        self.net = memory.net
        self._random = np.random.default_rng(seed)
        self.photo = self.net.describe(photo[None])
        self._fits = memory.fits(self.photo)
        self._links = memory.links.copy()
        self._plan_paths()
        self.belief = Belief(len(memory.frames), memory.shortcuts)
        self._usual = LEAST  # likeness of any frame
        self._count = 0
        self._last = IDLE
        self._seen: NDArray[np.int64] | None = None
        self._moves: list[int] = []
        self._stopped = 0
        self._lost = 0
        self._since = 0
        self._least = np.inf

    def act(self, frame: NDArray[np.uint8]) -> int:
        """What to do next, one of `BUTTONS`, where a frame is seen, RGB, uint8 ``[H, W, 3]``."""
        seen = self.net.describe(frame[None])
        self._believe(seen)
        self._notice_walls(frame)
        node, sure = self.belief.frame()
        action = self._moves.pop() if self._moves else self._follow(seen, node, sure)
        if {action, self._last} == {TURN_LEFT, TURN_RIGHT} and self._random.random() < 0.5:
            action = AHEAD  # else it would turn to and fro
        self._count += 1
        self._last = action
        return action

    def _believe(self, seen: TensorDict) -> None:
        """Where one is: moves spread the belief, and what is seen weighs it."""
        self.belief.move()
        count = len(self.belief.of)
        everywhere = self._count % ALL == 0 or (self._lost > 0 and self._count % 3 == 0)
        if everywhere or count <= LOOKED:
            some = np.arange(0, count, 2)
            found = self.net.likeness(seen, self.memory.columns[some])
            self._usual = float(np.median(found))
            likeness = np.interp(np.arange(count), some, found)
        else:
            some = np.unique(np.argpartition(-self.belief.of, LOOKED)[:LOOKED] // 2 * 2)
            found = self.net.likeness(seen, self.memory.columns[some])
            likeness = np.full(count, self._usual)
            likeness[some] = found
            likeness[np.minimum(some + 1, count - 1)] = found
        self.belief.weigh((likeness + LEAST) ** EVIDENCE)

    def _notice_walls(self, frame: NDArray[np.uint8]) -> None:
        """Steps aside where the view stayed the same."""
        small = frame[::2, ::2].astype(int)
        same = self._seen is not None and bool(np.abs(small - self._seen).mean() < SAME_VIEW)
        self._seen = small
        self._stopped = self._stopped + (self._last < IDLE) if same else 0
        if self._stopped >= 2:
            self._stopped = 0
            self._moves = [int(self._random.choice([LEFT, RIGHT, BACK]))] * int(self._random.integers(1, 4))

    def _follow(self, seen: TensorDict, node: int, sure: float) -> int:
        """Towards the farthest frame of the path that is recognised; a turn where there is none."""
        path = [node]
        while len(path) < ON_THE_WAY and self.far[path[-1]] > 0:
            path.append(int(self._following[path[-1]]))
        columns = self.memory.columns[np.array(path)]
        if at_end := self.far[path[-1]] == 0:
            columns = torch.cat([columns, self.photo])
        fit = self.net.fit(seen, columns)
        best = fit.score.max()
        if sure < SURE or best < SEEN:
            self._lost += 1
            return self._wander() if self._lost % CIRCLE == 0 else TURN_RIGHT
        self._lost = 0
        self._since = 0 if self.far[node] < self._least - 0.5 else self._since + 1
        self._least = min(self._least, self.far[node])
        if self._since > PATIENCE:
            self._doubt(path)
            return self._wander()
        known = (fit.score >= max(NEARLY * best, 0.6 * SEEN)) & (np.abs(fit.turned) < 70)
        leading = int(np.flatnonzero(known).max()) if known.any() else int(fit.score.argmax())
        to_photo = at_end and leading == len(path)
        backwards = 0 < leading < len(path) and all(0 <= path[k] - path[k + 1] <= 1 for k in range(leading))
        return self._towards(*(float(value[leading]) for value in fit[1:]), backwards=backwards, to_photo=to_photo)

    def _towards(self, ahead: float, right: float, turned: float, *, backwards: bool, to_photo: bool) -> int:
        """The move that leads to a frame; one that shows the goal is walked past."""
        if ahead > 60:
            turned = (turned - np.degrees(np.arctan2(right, ahead))) / 2
        # In Doom a turn that follows a turn is one of 28 degrees, any other one of 7.
        if abs(turned) > (18 if self._last in (TURN_LEFT, TURN_RIGHT) else 10):
            return TURN_LEFT if turned > 0 else TURN_RIGHT
        if abs(right) > 25 and abs(right) > 0.8 * abs(ahead):
            return RIGHT if right > 0 else LEFT
        return BACK if (backwards or ahead < -40) and not to_photo else AHEAD

    def _doubt(self, path: list[int]) -> None:
        """What did not lead on costs more; a goal that was reached in vain is given up for the next best."""
        if len(path) < 4:
            self._fits[max(0, path[-1] - SAME_PLACE) : path[-1] + SAME_PLACE] = -1
        for first, second in pairwise(path[:9]):
            self._links[first, second] += IN_VAIN
        self._plan_paths()

    def _plan_paths(self) -> None:
        goals = [int(self._fits.argmax())]
        self.far, self._following, _ = dijkstra(self._links.T, indices=goals, return_predecessors=True, min_only=True)

    def _wander(self) -> int:
        """Some steps at random, then again."""
        self._lost = 0
        self._since = 0
        self._least = np.inf
        self.belief.forget(0.3)
        side = int(self._random.choice([TURN_LEFT, TURN_RIGHT]))
        self._moves = [AHEAD] * int(self._random.integers(2, 8)) + [side] * int(self._random.integers(1, 6))
        return BACK
