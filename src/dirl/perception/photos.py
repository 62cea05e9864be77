"""Photos of another camera, as the agent's would have taken them."""

import math

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import map_coordinates


def as_seen_by(
    photo: NDArray[np.uint8], size: tuple[int, int], *, fov: float, own: float, tilt: float = 0.0
) -> NDArray[np.uint8]:
    """Scale, rotate and crop a photo to the views of the agent's camera.

    Both cameras stand at one point and look one way, so that this is exact; what the photo does not show is filled with
    its edge. A photo is compared with views patch by patch, at the same place in the picture: a wider or narrower field
    of view moves all of them.

    Args:
        photo: RGB, uint8 ``[H, W, 3]``; upright or across.
        size: height and width of the views, pixels.
        fov: horizontal field of view of the photo, degrees. For a phone it follows from the focal length that the
            photo's EXIF gives as that of 35 mm film, f: ``2 * degrees(atan(18 / f))`` across, with 12 upright.
        own: that of the agent's camera.
        tilt: degrees that the photo's camera was rolled to the left.

    Returns:
        uint8 ``[*size, 3]``.

    Raises:
        ValueError: an angle that no camera has.

    Example:
        >>> views = as_seen_by(np.zeros((400, 300, 3), np.uint8), (300, 400), fov=60, own=75)
        >>> views.shape
        (300, 400, 3)
    """
    for name, value in {"fov": fov, "own": own}.items():
        if not 1 <= value <= 170:
            raise ValueError(f"{name}={value:g}: a field of view is 1 to 170 degrees")
    (height, width), (rows, columns) = size, photo.shape[:2]
    zoom = columns * math.tan(math.radians(own / 2)) / (width * math.tan(math.radians(fov / 2)))
    cosine, sine = zoom * math.cos(math.radians(tilt)), zoom * math.sin(math.radians(tilt))
    # Pixels of the photo by those of the view, counted from the middle of both.
    x, y = np.meshgrid(np.arange(width) - (width - 1) / 2, np.arange(height) - (height - 1) / 2)
    column, row = x * cosine - y * sine + (columns - 1) / 2, x * sine + y * cosine + (rows - 1) / 2
    # As many pixels of the photo as one of the view covers are averaged.
    soft = np.asarray(Image.fromarray(photo).reduce(max(1, round(zoom))), float)
    at = [(where + 0.5) * len(soft) / rows - 0.5 for where in (row, column)]
    channels = [map_coordinates(soft[..., channel], at, order=1, mode="nearest") for channel in range(3)]
    return np.rint(np.stack(channels, -1)).astype(np.uint8)
