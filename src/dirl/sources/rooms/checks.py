"""Problems of a room: overlapping furniture, blocked doors, views without contrast."""

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from dirl.sources.rooms.description import Piece, RoomDescription
from dirl.sources.rooms.layout import assemble_pieces, place_of
from dirl.sources.rooms.mesh import Array, Part
from dirl.sources.rooms.navigation import Walk, clearance, footprints, walk

BLANK = 8.0
"""A view whose grey values have a smaller standard deviation (of 255) is nearly blank."""

ALIKE = 0.9
"""Two views whose thumbnails have a larger normalised cross-correlation look alike."""

NEAR = 1.01
"""Metres: views from so near that face about the same way may look alike."""

MARGIN = 0.015
"""Metres that things may reach into each other: a picture into plaster, a foot into a rug."""

DOOR_SPACE = 0.6
"""Metres in front of a door that must be free."""

COVERED = 0.6
"""Share of the free floor that the places must reach, else part of the room is cut off."""


def check_room(room: RoomDescription) -> list[str]:
    """The problems of a room's furniture, one line each.

    Pieces that overlap, reach out of the room, or stand in front of a door; places that are cut off.
    """
    return [*_intersections(room), *_blocked_doors(room), *_cut_off(room)]


def _intersections(room: RoomDescription) -> list[str]:
    (_, _), *pieces = assemble_pieces(room)
    boxes = [_boxes(parts, place_of(piece, room)[2]) for (_, parts), piece in zip(pieces, room.furniture, strict=True)]
    found = []
    for (where, parts), piece in zip(pieces, room.furniture, strict=True):
        corners = np.concatenate([part.corners.reshape(-1, 3) for part in parts])
        outside = np.maximum(-corners.min(0), corners.max(0) - room.size).max()
        if outside > MARGIN and piece.kind != "ceiling_lamp":
            found.append(f"{where} reaches {100 * outside:.0f} cm out of the room")
    for i, (name, _) in enumerate(pieces):
        for j in range(i + 1, len(pieces)):
            depth = _overlap(boxes[i], boxes[j])
            if depth > MARGIN:
                found.append(f"{name} and {pieces[j][0]} reach {100 * depth:.0f} cm into each other")
    return found


def _boxes(parts: list[Part], yaw: float) -> Array:
    """A turned box around each part: its frame's x and y axes, lower and upper corner in that frame, ``[n, 10]``."""
    c, s = np.cos(np.radians(yaw)), np.sin(np.radians(yaw))
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    inside = [part.corners.reshape(-1, 3) @ turn for part in parts]
    return np.array([[c, s, -s, c, *corners.min(0), *corners.max(0)] for corners in inside])


def _overlap(a: Array, b: Array) -> float:
    """How far the deepest pair of boxes reach into each other, metres along the best way out; 0 if none meet."""
    a, b = a[:, None], b[None]
    depths = [np.minimum(a[..., 9], b[..., 9]) - np.maximum(a[..., 6], b[..., 6])]
    corners_a, corners_b = _plan_corners(a), _plan_corners(b)
    for frame in (a, b):
        for axis in (frame[..., 0:2], frame[..., 2:4]):
            along_a, along_b = ((corners * axis[..., None, :]).sum(-1) for corners in (corners_a, corners_b))
            depths.append(np.minimum(along_a.max(-1), along_b.max(-1)) - np.maximum(along_a.min(-1), along_b.min(-1)))
    return float(max(0.0, np.minimum.reduce(depths).max()))


def _plan_corners(box: Array) -> Array:
    """The four corners of boxes seen from above, ``[..., 4, 2]``."""
    x_axis, y_axis = box[..., 0:2], box[..., 2:4]
    picks = [(4, 5), (7, 5), (7, 8), (4, 8)]
    return np.stack([box[..., x, None] * x_axis + box[..., y, None] * y_axis for x, y in picks], -2)


def _blocked_doors(room: RoomDescription) -> list[str]:
    found, solid = [], footprints(room)
    for number, piece in enumerate(room.furniture, 1):
        if piece.kind == "door":
            start, end = door_strip(piece, room)
            if clearance(start[None], end[None], solid)[0] < DOOR_SPACE / 2 - MARGIN:
                found.append(f"[[furniture]] number {number} (door): less than {DOOR_SPACE} m in front of it are free")
    return found


def door_strip(door: Piece, room: RoomDescription) -> tuple[Array, Array]:
    """The line in the middle of the space in front of a door that must be free, from side to side."""
    x, y, yaw = place_of(door, room)
    turn = np.radians(yaw)
    across, inwards = np.array([np.cos(turn), np.sin(turn)]), np.array([np.sin(turn), -np.cos(turn)])
    middle = np.array([x, y]) + inwards * (DOOR_SPACE / 2 - door.size[1] / 2)
    half = max(0.0, door.size[0] / 2 - DOOR_SPACE / 2)
    return middle - across * half, middle + across * half


def _cut_off(room: RoomDescription) -> list[str]:
    """Compare the places with all free points of the grid."""
    steps = [np.arange(start, end, room.grid.step) for start, end in zip(room.grid.origin, room.size[:2], strict=True)]
    points = np.stack(np.meshgrid(*steps, indexing="ij"), -1).reshape(-1, 2)
    radius = room.grid.radius
    indoors = ((points >= radius) & (points <= np.array(room.size[:2]) - radius)).all(1)
    free = int((indoors & (clearance(points, points, footprints(room)) >= radius)).sum())
    places = len(walk(room).places)
    if places < COVERED * free:
        return [f"[grid] only {places} of {free} free points can be reached from each other"]
    return []


def thumbnail(view: Array) -> Array:
    """A view as 32x24 grey values, float32 ``[24, 32]``."""
    small = Image.fromarray(view).convert("L").resize((32, 24), Image.Resampling.BOX)
    return np.asarray(small, np.float32)


def contrast(view: Array) -> float:
    """The standard deviation of a view's grey values, of 255."""
    return float(np.asarray(Image.fromarray(view).convert("L"), np.float32).std())


def check_views(thumbnails: Array, contrasts: Array, way: Walk) -> list[str]:
    """The problems of a room's views, one line each: nearly blank ones, far pairs that look alike.

    Args:
        thumbnails: of every state, see `thumbnail`, float32 ``[N, 24, 32]``.
        contrasts: of every state, see `contrast`, ``[N]``.
        way: the states.
    """
    found = [
        f"state {state}: its view is nearly blank (standard deviation {contrasts[state]:.1f} of 255)"
        for state in np.flatnonzero(contrasts < BLANK)
    ]
    likeness = correlation(thumbnails)
    turns = len(way.headings)
    positions, headings = np.repeat(way.places, turns, 0), np.tile(way.headings, len(way.places))
    for a, b in np.argwhere(np.triu((likeness > ALIKE) & far_apart(positions, headings), 1)):
        found.append(f"states {a} and {b} look alike (correlation {likeness[a, b]:.2f}) but are far apart")
    return found


def far_apart(positions: Array, headings: Array) -> NDArray[np.bool_]:
    """Which pairs of states should not look alike: over a metre or at least 90 degrees apart, bool ``[N, N]``."""
    apart = np.abs((headings[:, None] - headings + 180) % 360 - 180)
    return (apart >= 90) | (np.hypot(*(positions[:, None] - positions).transpose(2, 0, 1)) > NEAR)


def correlation(thumbnails: Array) -> Array:
    """The normalised cross-correlation of all pairs of thumbnails ``[N, h, w]``, ``[N, N]``."""
    flat = thumbnails.reshape(len(thumbnails), -1)
    flat = flat - flat.mean(1, keepdims=True)
    flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-6)
    return flat @ flat.T
