"""A ROS 2 node that drives a robot to the place of one photo, with `dirl.Navigator`.

    python ros2_navigator.py --ros-args -p run:=runs/any_goal -p explore:=my_map -p panorama:=/camera
    python ros2_navigator.py --ros-args -p run:=runs/any_goal -p goal:=photo.jpg -p graph:=my_map -p panorama:=/camera

The first walks through the place once and makes a map, the second goes to the photo with it.
It subscribes to one panoramic camera (parameter ``panorama``), or to four cameras (``ahead``, ``right``, ``back``,
``left``), and publishes ``cmd_vel``. Moves are timed: a robot with odometry should drive by that instead. ROS 2 is only
imported by `main`; what decides is `Pilot`, which is tested without it (tests/test_examples.py).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from dirl.sources.tours.pixels import cut

SIDES = ("ahead", "right", "back", "left")

MOVES = {0: (1, 0), 1: (0, -1), 2: (0, 1), 3: (-1, 0)}
"""Of ahead, right, left and back the signs of linear and angular velocity (ROS turns anticlockwise)."""


class Pilot:
    """Looks, decides, drives, waits until the robot stands, and looks again.

    Args:
        navigator: after ``reset`` with the goal; or a `Walk`.
        drive: sets the linear velocity, m/s, and the angular one, rad/s.
        step: metres of a move, as in the training.
        turn: degrees of a turn, likewise.
        speed: of moves, m/s.
        rate: of turns, rad/s.
        settle: seconds between the end of a move and the images that are used.
    """

    def __init__(
        self,
        navigator: Any,
        drive: Callable[[float, float], None],
        *,
        step: float = 0.5,
        turn: float = 90.0,
        speed: float = 0.2,
        rate: float = 0.5,
        settle: float = 0.3,
    ) -> None:
        self.navigator, self.drive = navigator, drive
        self.seconds = {0: step / speed, 1: np.radians(turn) / rate, 2: np.radians(turn) / rate, 3: step / speed}
        self.speed, self.rate, self.settle = speed, rate, settle
        self.images: dict[str, np.ndarray] = {}
        self.stands_at = 0.0
        """When the last move is over, seconds; images taken before are of no use."""
        self.moving = self.arrived = False

    def see(self, side: str, image: np.ndarray, taken: float) -> None:
        """Take an image of one side, uint8 RGB ``[H, W, 3]``, and when it was taken, seconds."""
        if not self.moving and taken >= self.stands_at + self.settle * (self.stands_at > 0):
            self.images[side] = image

    def see_panorama(self, image: np.ndarray, taken: float, size: tuple[int, int], field_of_view: float) -> None:
        """Take an equirectangular image, uint8 RGB ``[H, 2 H, 3]``, and cut the four views out of it."""
        for side, yaw in zip(SIDES, (0, 90, 180, 270), strict=True):
            self.see(side, cut([image], yaw, size, field_of_view), taken)

    def tick(self, now: float) -> None:
        """Go on, at the time ``now`` in seconds; to be called several times a second."""
        if self.moving and now >= self.stands_at:
            self.drive(0.0, 0.0)
            self.moving = False
            self.images.clear()
        if self.arrived or self.moving or set(self.images) != set(SIDES):
            return
        decision = self.navigator.act(np.stack([self.images[side] for side in SIDES]))
        if decision.stop:
            self.arrived = True
            self.drive(0.0, 0.0)
            return
        linear, angular = MOVES[decision.action]
        self.moving, self.stands_at = True, now + self.seconds[decision.action]
        self.drive(linear * self.speed, angular * self.rate)


class Step(NamedTuple):
    """What `Pilot` reads of a decision."""

    action: int
    stop: bool


class Walk:
    """A walk that makes a map, in the place of the navigator in a `Pilot`; it stops where nothing is left to learn.

    Args:
        explorer: see `dirl.Navigator.explore`.
        folder: where the map is written, anew after each observation, so that a walk may be ended at any time.
    """

    def __init__(self, explorer: Any, folder: str) -> None:
        self.explorer, self.folder = explorer, folder
        self.action: int | None = None

    def act(self, images: np.ndarray) -> Step:
        """Add what is seen to the map, and choose where to go on."""
        self.explorer.see(images, self.action)
        self.explorer.save(self.folder)
        self.action = self.explorer.next_action()
        return Step(self.action or 0, self.action is None)


def pixels(message: Any) -> np.ndarray:
    """The pixels of a ``sensor_msgs/Image``, uint8 RGB ``[H, W, 3]``.

    Raises:
        ValueError: an encoding other than rgb8 and bgr8.
    """
    if message.encoding not in ("rgb8", "bgr8"):
        raise ValueError(f"the camera's encoding is {message.encoding}; set it to rgb8 or bgr8")
    rows = np.frombuffer(bytes(message.data), np.uint8).reshape(message.height, message.step)
    image = rows[:, : 3 * message.width].reshape(message.height, message.width, 3)
    return image[..., ::-1] if message.encoding == "bgr8" else image


def main() -> None:
    """The node."""
    import rclpy
    from geometry_msgs.msg import Twist
    from PIL import Image as Picture
    from rclpy.node import Node
    from sensor_msgs.msg import Image

    from dirl import Navigator

    rclpy.init()
    node = Node("dirl_navigator")
    defaults = {"run": "", "encoder": "resnet50_small", "explore": "", "goal": "", "graph": "", "last_steps": 3}
    defaults |= {"step": 0.5, "turn": 90.0, "panorama": "", "fov": 90.0}
    given = {name: node.declare_parameter(name, value).value for name, value in defaults.items()}
    topics = {side: node.declare_parameter(side, f"/camera_{side}/image").value for side in SIDES}
    navigator = Navigator.load(given["run"], given["encoder"])
    if given["explore"]:
        leader = Walk(navigator.explore(turns=round(360 / given["turn"])), given["explore"])
    else:
        photo = np.asarray(Picture.open(given["goal"]).convert("RGB"))
        navigator.reset(photo, graph=given["graph"] or None, last_steps=given["last_steps"])
        leader = navigator
    wheels = node.create_publisher(Twist, "cmd_vel", 1)

    def drive(linear: float, angular: float) -> None:
        twist = Twist()
        twist.linear.x, twist.angular.z = float(linear), float(angular)
        wheels.publish(twist)

    pilot = Pilot(leader, drive, step=given["step"], turn=given["turn"])

    def stamp(message: Any) -> float:
        return float(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)

    if given["panorama"]:
        node.create_subscription(
            Image, given["panorama"], lambda m: pilot.see_panorama(pixels(m), stamp(m), (300, 400), given["fov"]), 1
        )
    else:
        for side, topic in topics.items():
            node.create_subscription(Image, topic, lambda m, side=side: pilot.see(side, pixels(m), stamp(m)), 1)
    node.create_timer(0.1, lambda: pilot.tick(node.get_clock().now().nanoseconds * 1e-9))
    rclpy.spin(node)


if __name__ == "__main__":
    main()
