"""Doors, windows, mirrors and pictures: what hangs in a frame on a wall."""

import numpy as np

from dirl.rooms.mesh import Array, Mesh


def picture(w: float, d: float, h: float, *, image: str = "art_a", frame: str = "wood_dark", z: float = 1.5) -> Mesh:
    """A picture in a frame, its middle at height z; w and h are without the frame."""
    edge, back, front = 0.03, d / 2, d / 2 - 0.03
    z0, z1 = z - h / 2, z + h / 2
    mesh = Mesh()
    mesh.box(-w / 2 - edge, front, z0 - edge, w / 2 + edge, back, z0, frame, 0.006)
    mesh.box(-w / 2 - edge, front, z1, w / 2 + edge, back, z1 + edge, frame, 0.006)
    mesh.box(-w / 2 - edge, front, z0, -w / 2, back, z1, frame, 0.006)
    mesh.box(w / 2, front, z0, w / 2 + edge, back, z1, frame, 0.006)
    y = back - 0.012
    return mesh.quad([(-w / 2, y, z0), (w / 2, y, z0), (w / 2, y, z1), (-w / 2, y, z1)], image, image=True)


def mirror(w: float, d: float, h: float, *, frame: str = "wood", z: float = 1.55) -> Mesh:
    """A mirror in a frame, its middle at height z."""
    return picture(w, d, h, image="mirror", frame=frame, z=z)


def window(
    w: float,
    d: float,
    h: float,
    *,
    outlook: str = "outdoors",
    frame: str = "white_paint",
    z: float = 1.5,
    panes: tuple[int, int] = (2, 2),
    curtain: str = "",
) -> Mesh:
    """A window, its middle at height z: a bright panel behind bars gives daylight and a view at once."""
    mesh = picture(w, d, h, image=outlook, frame=frame, z=z)
    z0, y = z - h / 2, d / 2 - 0.022
    for i in range(1, panes[0]):
        x = -w / 2 + i * w / panes[0]
        mesh.box(x - 0.015, y - 0.02, z0, x + 0.015, y, z0 + h, frame, 0.003)
    for j in range(1, panes[1]):
        bar = z0 + j * h / panes[1]
        mesh.box(-w / 2, y - 0.02, bar - 0.015, w / 2, y, bar + 0.015, frame, 0.003)
    mesh.box(-w / 2 - 0.08, d / 2 - 0.14, z0 - 0.06, w / 2 + 0.08, d / 2, z0 - 0.03, frame, 0.006)
    if curtain:
        rod = z + h / 2 + 0.1
        mesh.tube([(-w / 2 - 0.2, d / 2 - 0.1, rod), (w / 2 + 0.2, d / 2 - 0.1, rod)], 0.012, "brass")
        for side in (-1, 1):
            mesh.sheet(_drape(side * (w / 2 + 0.15), -side * 0.28, d / 2 - 0.1, z0 - 0.25, h + 0.33), 60, 10, curtain)
    return mesh


def _drape(x0: float, width: float, y: float, z0: float, height: float):  # type: ignore[no-untyped-def]
    """Cloth that hangs in folds from x0 to x0 + width."""

    def surface(u: Array, v: Array) -> Array:
        across = u if width > 0 else 1 - u  # the same side of the cloth faces the room on either end
        folds = 0.025 * np.sin(across * 26) * (1 - 0.5 * v)
        return np.stack([x0 + width * across, y - folds, z0 + height * v], -1)

    return surface


def door(w: float, d: float, h: float, *, leaf: str = "door", frame: str = "white_paint", trim: str = "brass") -> Mesh:
    """A closed door with four panels in its frame; w and h are the leaf's."""
    y = d / 2
    mesh = Mesh().box(-w / 2 - 0.08, y - 0.035, 0, -w / 2, y, h + 0.08, frame, 0.006)
    mesh.box(w / 2, y - 0.035, 0, w / 2 + 0.08, y, h + 0.08, frame, 0.006)
    mesh.box(-w / 2, y - 0.035, h, w / 2, y, h + 0.08, frame, 0.006)
    mesh.box(-w / 2, y - 0.028, 0, w / 2, y, h, leaf, 0.0)
    for z0, z1 in ((0.15, 0.85), (1.0, h - 0.15)):
        for x0, x1 in ((-w / 2 + 0.1, -0.04), (0.04, w / 2 - 0.1)):
            mesh.box(x0, y - 0.042, z0, x1, y - 0.01, z1, leaf, 0.012)
    handle = [(0.07, 0.02), (0.07, 0.07), (0.18, 0.07)]
    return mesh.tube([(w / 2 - dx, y - dy, 0.98) for dx, dy in handle], 0.011, trim)
