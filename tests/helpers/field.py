"""A simulator of a few lines."""

import numpy as np

from dirl.scenes.live import Pose


class Field:
    """A square of places a metre apart; each view has a colour of its own."""

    name = "field"

    def __init__(self, size=3.0):
        self.size, self.pose, self.looks = size, Pose(0.0, 0.0, 0.0), 0

    def place(self, pose):
        self.pose = pose

    def push(self, metres):
        x, z, heading = self.pose
        end = x + metres * np.sin(np.radians(heading)), z + metres * np.cos(np.radians(heading))
        free = min(end) > -0.5 and max(end) < self.size - 0.5
        self.pose = Pose(*end, heading) if free else self.pose
        return free

    def look(self, heading):
        self.looks += 1
        x, z, _ = self.pose
        turn = np.radians(heading)
        colours = [[[40 * x, 40 * z, 0]], [[128 + 99 * np.sin(turn), 128 + 99 * np.cos(turn), 0]]]
        return np.array(colours).astype(np.uint8)
