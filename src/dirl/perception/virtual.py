"""Virtual views: what cameras unlike the agent's would see at each of its visits.

A photo from another camera, of a narrower field of view or turned aside, is at no visit like what the agent sees: the
same things are elsewhere in the picture, and larger. But it is like what its own camera would have seen there, and that
can be made of the agent's four views.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class VirtualCameras:
    """Cameras at the agent's place, by which photos of another camera are found.

    Args:
        fov: their horizontal field of view, degrees. Photos with a wider one are cropped to it, see
            `dirl.perception.photos.as_seen_by`.
        yaws: degrees that they are turned to the right of each of the agent's views.
        own: the agent's field of view, degrees.
        pitch: degrees that the agent's cameras look up; negative down.

    Raises:
        ValueError: an angle that no camera has, or no yaw.
    """

    fov: float
    yaws: tuple[float, ...] = (0.0, -15.0, 15.0, -30.0, 30.0, 45.0)
    own: float = 75.0
    pitch: float = 0.0

    def __post_init__(self) -> None:
        for name, value in {"fov": self.fov, "own": self.own}.items():
            if not 1 <= value <= 170:
                raise ValueError(f"virtual.{name}={value:g}: a field of view is 1 to 170 degrees")
        if not self.yaws or not all(-180 <= yaw <= 180 for yaw in self.yaws):
            raise ValueError(f"virtual.yaws={list(self.yaws)}: at least one, of -180 to 180 degrees")
        if abs(self.pitch) > 80:
            raise ValueError(f"virtual.pitch={self.pitch:g}: must be -80 to 80 degrees")

    def __str__(self) -> str:
        return f"virtual views of {self.fov:g} degrees at yaws {', '.join(f'{yaw:g}' for yaw in self.yaws)}"

    def see(self, views: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """What they see at visits, ``[..., 4, H, W, 3]``, instead of the view ahead: uint8 ``[..., yaws, H, W, 3]``."""
        each = [virtual_views(views, fov=self.fov, own=self.own, yaw=yaw, pitch=self.pitch) for yaw in self.yaws]
        return np.stack(each, -4)

    def around(self, views: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The same instead of each of the four views, uint8 ``[B, 4, yaws, H, W, 3]``, of ``[B, 4, H, W, 3]``."""
        return np.stack([self.see(np.roll(views, -turns, 1)) for turns in range(views.shape[1])], 1)


def virtual_views(
    views: NDArray[np.uint8], *, fov: float, own: float, yaw: float = 0.0, pitch: float = 0.0
) -> NDArray[np.uint8]:
    """What a camera of another field of view, turned aside, would show where the agent stands.

    Each pixel is looked up, bilinearly, in that of the agent's four views that is nearest to its direction. Cameras of
    less than 90 degrees leave gaps between the views, which are filled with the edge.

    Args:
        views: of the agent, ahead, right, back and left, RGB, uint8 ``[..., 4, H, W, 3]``.
        fov: horizontal field of view of the virtual camera, degrees.
        own: that of the agent's.
        yaw: degrees that the virtual camera is turned to the right.
        pitch: degrees that both cameras look up; negative down.

    Returns:
        uint8 ``[..., H, W, 3]``.

    Example:
        >>> views = np.zeros((10, 4, 48, 64, 3), np.uint8)
        >>> virtual_views(views, fov=50, own=75, yaw=45).shape
        (10, 48, 64, 3)
    """
    from scipy.ndimage import map_coordinates  # here: most commands make no virtual views, and this takes 0.1 s

    at = _looked_up(views.shape[-3:-1], fov, own, yaw, pitch)
    seen = [
        [map_coordinates(visit[..., channel], at, float, order=1, mode="nearest") for channel in range(3)]
        for visit in views.reshape(-1, *views.shape[-4:])
    ]
    colours = np.moveaxis(np.array(seen), 1, -1).reshape(*views.shape[:-4], *views.shape[-3:])
    return np.rint(colours).astype(np.uint8)


@lru_cache(maxsize=64)
def _looked_up(size: tuple[int, ...], fov: float, own: float, yaw: float, pitch: float) -> NDArray[np.float64]:
    """Of each pixel of a virtual view the agent's view, and row and column there, ``[3, H, W]``."""
    (height, width), (half, own_half) = size, (math.tan(math.radians(angle / 2)) for angle in (fov, own))
    across = ((np.arange(width) + 0.5) / width * 2 - 1) * half
    down = ((np.arange(height) + 0.5) / height * 2 - 1) * half * height / width
    x, y = np.meshgrid(across, down)
    sine, cosine = math.sin(math.radians(pitch)), math.cos(math.radians(pitch))
    level, up = cosine + y * sine, sine - y * cosine
    azimuth = np.arctan2(x, level) + math.radians(yaw)
    view = np.rint(azimuth / (math.pi / 2)).astype(int)
    beside, length = azimuth - view * math.pi / 2, np.hypot(x, level)
    right, ahead = length * np.sin(beside), length * np.cos(beside)
    depth, below = np.maximum(ahead * cosine + up * sine, 1e-9), ahead * sine - up * cosine
    column = ((right / depth / own_half + 1) * width - 1) / 2
    row = ((below / depth / (own_half * height / width) + 1) * height - 1) / 2
    return np.stack([view % 4, np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)])
