"""Live worlds, whose views are made when they are seen: a simulator, a robot's room, or a dump.

A world is anything with the four members of `LiveWorld`. `Simulated` makes one of a simulator, `Dumped` of a scene, and
`Noisy` lets the moves of another world go wrong.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from dirl.scenes.graph import AHEAD, BACK, LEFT, RIGHT, turns_per_circle
from dirl.scenes.scene import Scene, SceneError
from dirl.scenes.views import check_image

Image = NDArray[np.uint8]


class SimulatorError(SceneError):
    """A simulator failed, while nothing is wrong with what it was asked for; ``then`` says what to do now."""

    def __init__(self, failure: str, then: str) -> None:
        super().__init__(failure, then)  # both, so that it can be pickled, as by the processes of `in_processes`
        self.failure = failure

    def __str__(self) -> str:
        """Return both in one line."""
        return "; ".join(self.args)


class Pose(NamedTuple):
    """Where an agent is."""

    x: float
    """Metres."""
    z: float
    """Metres."""
    heading: float
    """Degrees clockwise from +z."""


class LiveWorld(Protocol):
    """A place to walk in."""

    @property
    def pose(self) -> Pose:
        """Where the agent is."""

    def reset(self, pose: Pose) -> None:
        """Put the agent somewhere; `SceneError` where it cannot stand."""

    def step(self, action: int, error: float = 0.0) -> bool:
        """Take one of `dirl.scenes.ACTIONS`, with a turn by ``error`` degrees clockwise too many; whether it moved."""

    def views(self) -> Image:
        """Return what is ahead, to the right, behind and to the left: uint8 RGB ``[4, H, W, 3]``."""


class Simulator(Protocol):
    """What a simulator must be able to do."""

    name: str
    """Of the scene in it."""

    @property
    def pose(self) -> Pose:
        """Where the agent is."""

    def place(self, pose: Pose) -> None:
        """Put the agent somewhere; `SceneError` if that fails."""

    def push(self, metres: float) -> bool:
        """Try to walk along the heading, backwards if negative; where blocked the agent stays where it was."""

    def look(self, heading: float) -> Image:
        """Return the view towards a heading, uint8 RGB ``[H, W, 3]``."""


def looked(simulator: Simulator, heading: float) -> Image:
    """Return the view towards a heading; `SceneError` if it is no image."""
    return check_image(simulator.look(heading), f"{simulator.name}: look()")


def stride(heading: float, step: float) -> float:
    """Return the metres of a move along a heading on a grid: to the next place on an axis or a diagonal, else none."""
    if round(heading) % 45:
        return 0.0
    return step if round(heading) % 90 == 0 else step * 2**0.5


def turns_by_angle(turn: float) -> int:
    """Return how many turns by so many degrees are a full circle; `SceneError` unless they go into 90 without rest."""
    turns = round(360 / turn) if turn > 0 else 0
    if turns == 0 or turns % 4 or abs(360 / turns - turn) > 1e-9:
        raise SceneError(f"turn={turn:g}: a turn must go into 90 degrees without rest, as 90, 45 and 30 do")
    return turns


class Simulated:
    """The world of a simulator: an agent that moves as in the dumps made of it.

    A move along an axis is ``step`` metres long, and ``turns`` right turns are a full circle.
    """

    def __init__(self, simulator: Simulator, *, step: float, turns: int = 4) -> None:
        self.simulator, self.metres, self.turn = simulator, step, 360 / turns
        self.intended = simulator.pose.heading

    @property
    def pose(self) -> Pose:
        """Where the agent is."""
        return self.simulator.pose

    def reset(self, pose: Pose) -> None:
        """Put the agent somewhere."""
        with simulator_errors(self.simulator.name):
            self.simulator.place(pose)
        self.intended = pose.heading

    def step(self, action: int, error: float = 0.0) -> bool:
        """Take an action; whether the agent moved."""
        with simulator_errors(self.simulator.name):
            if action in (AHEAD, BACK):
                metres = stride(self.intended, self.metres)
                return metres > 0 and self.simulator.push(metres if action == AHEAD else -metres)
            turn = self.turn if action == RIGHT else -self.turn
            x, z, heading = self.pose
            self.intended = (self.intended + turn) % 360
            self.simulator.place(Pose(x, z, (heading + turn + error) % 360))
            return True

    def views(self) -> Image:
        """Return the four views around the agent."""
        with simulator_errors(self.simulator.name):
            heading = self.pose.heading
            return np.stack([looked(self.simulator, (heading + quarter) % 360) for quarter in (0, 90, 180, 270)])


class Dumped:
    """The world of a dump with views. Errors of turns add up, and the agent is in the state of the nearest heading."""

    def __init__(self, scene: Scene) -> None:
        if scene.views is None:
            raise SceneError(f"{scene.origin}: holds no views to walk among")
        self.scene, self._views = scene, scene.views
        self._half = 180 / turns_per_circle(scene.graph)
        self.state, self._off = 0, 0.0

    @property
    def pose(self) -> Pose:
        """Where the agent is."""
        return state_pose(self.scene, self.state)

    def reset(self, pose: Pose) -> None:
        """Put the agent into the state of a pose."""
        near = np.abs(self.scene.positions - (pose.x, pose.z)).max(1) < 1e-3
        here = near & (np.abs((self.scene.headings - pose.heading + 180) % 360 - 180) < 1)
        if not here.any():
            raise SceneError(f"{self.scene.origin}: holds no state at {pose}")
        self.state, self._off = int(np.argmax(here)), 0.0

    def step(self, action: int, error: float = 0.0) -> bool:
        """Take an action; whether the agent moved."""
        moved = self._follow(action)
        self._off += error
        while abs(self._off) > self._half:
            self._follow(RIGHT if self._off > 0 else LEFT)
            self._off -= 2 * self._half * np.sign(self._off)
        return moved

    def _follow(self, action: int) -> bool:
        after = int(self.scene.graph[self.state, action])
        moved, self.state = after not in (-1, self.state), after if after >= 0 else self.state
        return moved

    def views(self) -> Image:
        """Return the four views around the agent."""
        return np.stack([self._views[int(state)] for state in self.scene.surrounding[self.state]])


class Noisy:
    """A world in which moves go wrong.

    With the probability ``slip`` an action has no effect; ``turn_error`` is the standard deviation of turns, degrees.
    """

    def __init__(self, world: LiveWorld, *, slip: float = 0.0, turn_error: float = 0.0, seed: int = 0) -> None:
        self.world, self.slip, self.turn_error = world, slip, turn_error
        self._draws = np.random.default_rng(seed)
        self.reset, self.views = world.reset, world.views

    @property
    def pose(self) -> Pose:
        """Where the agent is."""
        return self.world.pose

    def step(self, action: int, error: float = 0.0) -> bool:
        """Take an action, unless the agent slips; whether it moved."""
        if self._draws.random() < self.slip:
            return False
        if action in (RIGHT, LEFT):
            error += self.turn_error * self._draws.standard_normal()
        return self.world.step(action, error)


def state_pose(scene: Scene, state: int) -> Pose:
    """Return where a state of a dump is."""
    x, z = scene.positions[state].tolist()
    return Pose(x, z, float(scene.headings[state]))


def repeats(world: LiveWorld, pose: Pose) -> bool:
    """Return True if a world shows the same views, bit for bit, to an agent that is put at a pose twice."""
    world.reset(pose)
    before = world.views()
    world.reset(pose)
    return np.array_equal(before, world.views())


def arrived(pose: Pose, wanted: Pose, within: float, degrees: float) -> bool:
    """Return True if a pose is within so many metres of another one, and turned away from it by so many degrees."""
    turned = abs((pose.heading - wanted.heading + 180) % 360 - 180)
    return bool(np.hypot(pose.x - wanted.x, pose.z - wanted.z) <= within and turned <= degrees)


def shortest_move(scene: Scene) -> float:
    """Return the metres of the shortest move ahead or back in a scene."""
    state, action = np.nonzero(scene.graph[:, [AHEAD, BACK]] >= 0)
    after = scene.graph[state, np.array([AHEAD, BACK])[action]]
    return float(np.linalg.norm(scene.positions[after] - scene.positions[state], axis=1).min())


@contextmanager
def simulator_errors(name: str, then: str = "run the command again") -> Iterator[None]:
    """Turn whatever a simulator raises within this context, each its own classes, into one line."""
    try:
        yield
    except SceneError:
        raise
    except Exception as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:300]
        raise SimulatorError(f"{name} failed ({reason})", then) from None
