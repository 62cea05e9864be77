"""A double of AI2-THOR's controller: it answers `step` with events as ai2thor 5.0 makes them, of a room on a grid."""

from types import SimpleNamespace

import numpy as np

NOISE = 3e-7
"""AI2-THOR's numbers are float32."""

ALONG = {0: (0, 1), 90: (1, 0), 180: (0, -1), 270: (-1, 0)}


class Simulator:
    """The agent walks on free cells of a grid; what it sees depends on where it is.

    Args:
        cells: free cells (x, z), as multiples of the step.
        step: metres.
        nowhere: cells that are listed as reachable, though the agent cannot be put there.
        shape: of a frame.
        crash_after: steps after which it raises as the controller does when Unity is gone.
    """

    def __init__(self, cells, *, step=0.5, nowhere=(), shape=(300, 400), crash_after=None):
        self.cells, self.step_size, self.nowhere, self.shape = list(cells), step, set(nowhere), shape
        self.cell, self.heading = self.cells[0], 90
        self.left, self.calls = crash_after, []

    def step(self, action, **arguments):
        self.calls.append(action)
        if self.left is not None:
            self.left -= 1
            if self.left < 0:
                raise RuntimeError(f"Error encountered when running action {action}\n in scene FloorPlan1.")
        success, message = True, ""
        if action == "Pass":
            pass
        elif action == "Teleport":
            assert set(arguments) == {"position", "rotation", "horizon", "standing"}
            cell = tuple(round(arguments["position"][axis] / self.step_size) for axis in "xz")
            if cell in self.nowhere or cell not in self.cells:
                success, message = False, "Collided with: \nSink_3."
            else:
                self.cell, self.heading = cell, round(arguments["rotation"]["y"])
        elif action in ("MoveAhead", "MoveBack"):
            sign = 1 if action == "MoveAhead" else -1
            to = tuple(at + sign * by for at, by in zip(self.cell, ALONG[self.heading], strict=True))
            if to in self.cells:
                self.cell = to
            else:
                success, message = False, "Wall is blocking Agent 0 from moving by (0.0000, 0.0000, 0.5000)."
        else:
            raise ValueError(f"Invalid action: {action}")
        rotation = {"x": -0.0, "y": self.heading + NOISE, "z": 0.0}
        metadata = {
            "agent": {"position": self.position(self.cell), "rotation": rotation},
            "lastActionSuccess": success,
            "errorMessage": message,
        }
        return SimpleNamespace(metadata=metadata, frame=self.frame())

    def position(self, cell):
        return {"x": cell[0] * self.step_size - NOISE, "y": 0.9009991884231567, "z": cell[1] * self.step_size + NOISE}

    def frame(self):
        """A gradient in the heading's colour with a bar for each coordinate."""
        frame = np.zeros((*self.shape, 3), np.uint8)
        frame[..., 0] = np.linspace(0, 200, self.shape[1])
        frame[..., 1] = 60 * (self.heading // 90)
        frame[: 10 + 10 * (self.cell[0] % 20)] += 20
        frame[:, : 10 + 10 * (self.cell[1] % 20), 2] = 200
        return frame
