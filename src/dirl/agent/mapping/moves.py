"""A path through a map of frames as something a person can do: turns in degrees, and ways ahead in seconds."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from dirl.agent.mapping.frames import FrameMap
from dirl.perception.matching import FrameMatcher

LEAST_TURN = 20.0
"""Degrees that are worth a word; smaller turns add up until they are."""

ON_THE_SPOT = 15.0
"""Degrees from one frame to the next, from which its time counts as turning."""

STRAIGHT = 8.0
"""Degrees from one frame to the next, below which a turn has come to its end."""


class Move(NamedTuple):
    """A part of a way; a turn or a way ahead."""

    turn: float
    """Degrees to the left; negative to the right, 0 for ahead."""
    ahead: float
    """Seconds at the pace of the recording."""
    frame: int
    """Of the map, where it ends."""

    def __str__(self) -> str:
        if not self.turn:
            return f"ahead {self.ahead:.0f} s"
        if abs(self.turn) > 150:
            return "turn around"
        return f"turn {'left' if self.turn > 0 else 'right'} {abs(self.turn):.0f} degrees"


def moves_along(graph: FrameMap, matcher: FrameMatcher, path: Sequence[int]) -> list[Move]:
    """Return turns and ways ahead along a path of frames.

    Turns are measured between successive frames. Where the path follows a recording back in time, one walks it the
    other way round.
    """
    moves: list[Move] = []
    turn, ahead, back = 0.0, 0.0, False
    for here, there in pairwise(path):
        motion = graph.motion(matcher, here, there)
        turned = 0.0 if motion is None else motion.turned
        in_time = abs(there - here) == 1 and graph.parts[here] == graph.parts[there]
        seconds = abs(float(graph.times[there] - graph.times[here])) if in_time else 0.0
        backwards = in_time and there < here
        if backwards != back:
            moves += _told(0.0, ahead, here)
            moves.append(Move(180.0, 0.0, here))
            ahead, back = 0.0, backwards
        turn += turned
        if abs(turned) < ON_THE_SPOT:
            ahead += seconds
        if abs(turn) >= LEAST_TURN and abs(turned) < STRAIGHT:
            moves += _told(turn, ahead, there)
            turn, ahead = 0.0, 0.0
    moves += _told(turn, ahead, path[-1])
    return [*moves, Move(180.0, 0.0, path[-1])] if back else moves


def _told(turn: float, ahead: float, frame: int) -> list[Move]:
    """Return a way ahead and the turn at its end, the shorter way round."""
    turn = (turn + 180) % 360 - 180
    return [Move(0.0, ahead, frame)] * (ahead > 0) + [Move(turn, 0.0, frame)] * (abs(turn) >= LEAST_TURN)
