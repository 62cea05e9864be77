"""Problems of a room: overlapping furniture, blocked doors, views without contrast."""

from itertools import combinations

import numpy as np
from PIL import Image

from dirl.sources.rooms.description import Piece, RoomDescription, Size
from dirl.sources.rooms.layout import assemble_pieces, place_of
from dirl.sources.rooms.mesh import Array, Part
from dirl.sources.rooms.walkable import Walk, clearance, footprints, free_points, walk

BLANK = 8.0
"""A view whose grey values have a smaller standard deviation (of 255) is nearly blank."""

ALIKE = 0.9
"""Two views whose thumbnails have a larger normalised cross-correlation look alike."""

STRIDE = 1.01
"""Metres: views from so near that face about the same way may look alike."""

MARGIN = 0.015
"""Metres that things may reach into each other: a picture into plaster, a foot into a rug."""

DOOR_SPACE = 0.6
"""Metres in front of a door that must be free."""

COVERED = 0.6
"""Share of the free floor that the places must reach, else part of the room is cut off."""


def check_room(room: RoomDescription) -> list[str]:
    """Return the problems of a room's furniture, one line each.

    Pieces that overlap, reach out of the room, or stand in front of a door; places that are cut off.
    """
    problems, boxes, solid = [], [], footprints(room)
    for (where, parts), piece in zip(assemble_pieces(room)[1:], room.furniture, strict=True):
        boxes.append((where, _boxes(parts, place_of(piece, room.size)[2])))
        corners = np.concatenate([part.corners.reshape(-1, 3) for part in parts])
        outside = np.maximum(-corners.min(0), corners.max(0) - room.size).max()
        if outside > MARGIN and piece.kind != "ceiling_lamp":
            problems.append(f"{where} reaches {100 * outside:.0f} cm out of the room")
    for (first, its_boxes), (other, others_boxes) in combinations(boxes, 2):
        depth = _overlap(its_boxes, others_boxes)
        if depth > MARGIN:
            problems.append(f"{first} and {other} reach {100 * depth:.0f} cm into each other")
    for (where, _), piece in zip(boxes, room.furniture, strict=True):
        if piece.kind == "door":
            start, end = door_strip(piece, room.size)
            if clearance(start[None], end[None], solid)[0] < DOOR_SPACE / 2 - MARGIN:
                problems.append(f"{where}: less than {DOOR_SPACE} m in front of it are free")
    places, free = len(walk(room).places), len(free_points(room)[0])
    if places < COVERED * free:
        problems.append(f"[grid] only {places} of {free} free points can be reached from each other")
    return problems


Boxes = tuple[Array, Array, Array]
"""Around the n parts of a piece, turned like it: axes seen from above ``[2, 2]``, corners ``[n, 4, 2]``, heights."""


def _boxes(parts: list[Part], yaw: float) -> Boxes:
    c, s = np.cos(np.radians(yaw)), np.sin(np.radians(yaw))
    turn, axes = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), np.array([[c, s], [-s, c]])
    inside = [part.corners.reshape(-1, 3) @ turn for part in parts]
    bounds = np.array([(corners.min(0), corners.max(0)) for corners in inside])
    corners = [bounds[:, i, 0, None] * axes[0] + bounds[:, j, 1, None] * axes[1] for i in (0, 1) for j in (0, 1)]
    return axes, np.stack(corners, 1), bounds[:, :, 2]


def _overlap(a: Boxes, b: Boxes) -> float:
    """Return how far the deepest pair of boxes reach into each other, metres along the best way out; 0 if none meet."""
    (axes_a, corners_a, heights_a), (axes_b, corners_b, heights_b) = a, b
    spans = [((corners_a * axis).sum(-1), (corners_b * axis).sum(-1)) for axis in (*axes_a, *axes_b)]
    depths = [
        np.minimum.outer(first.max(1), second.max(1)) - np.maximum.outer(first.min(1), second.min(1))
        for first, second in [(heights_a, heights_b), *spans]
    ]
    return float(max(0.0, np.minimum.reduce(depths).max()))


def door_strip(door: Piece, size: Size) -> tuple[Array, Array]:
    """Return the line in the middle of the space in front of a door that must be free, in a room of this size."""
    x, y, yaw = place_of(door, size)
    turn = np.radians(yaw)
    across, inwards = np.array([np.cos(turn), np.sin(turn)]), np.array([np.sin(turn), -np.cos(turn)])
    middle = np.array([x, y]) + inwards * (DOOR_SPACE / 2 - door.size[1] / 2)
    half = max(0.0, door.size[0] / 2 - DOOR_SPACE / 2)
    return middle - across * half, middle + across * half


def thumbnail(view: Array) -> Array:
    """Return a view as 32x24 grey values, float32 ``[24, 32]``."""
    small = Image.fromarray(view).convert("L").resize((32, 24), Image.Resampling.BOX)
    return np.asarray(small, np.float32)


def contrast(view: Array) -> float:
    """Return the standard deviation of a view's grey values, of 255."""
    return float(np.asarray(Image.fromarray(view).convert("L"), np.float32).std())


def check_views(thumbnails: Array, contrasts: Array, way: Walk) -> list[str]:
    """Return the problems of a room's views, one line each: nearly blank ones, far pairs that look alike.

    Args:
        thumbnails: of every state, see `thumbnail`, float32 ``[N, 24, 32]``.
        contrasts: of every state, see `contrast`, ``[N]``.
        way: the states.
    """
    problems = [
        f"state {state}: its view is nearly blank (standard deviation {contrasts[state]:.1f} of 255)"
        for state in np.flatnonzero(contrasts < BLANK)
    ]
    likeness = correlation(thumbnails)
    turns = len(way.headings)
    positions, headings = np.repeat(way.places, turns, 0), np.tile(way.headings, len(way.places))
    turned = np.abs((headings[:, None] - headings + 180) % 360 - 180)
    far = (turned >= 90) | (np.hypot(*(positions[:, None] - positions).transpose(2, 0, 1)) > STRIDE)
    for a, b in np.argwhere(np.triu((likeness > ALIKE) & far, 1)):
        problems.append(f"states {a} and {b} look alike (correlation {likeness[a, b]:.2f}) but are far apart")
    return problems


def correlation(thumbnails: Array) -> Array:
    """Return the normalised cross-correlation of all pairs of thumbnails ``[N, h, w]``, ``[N, N]``."""
    flat = thumbnails.reshape(len(thumbnails), -1)
    flat = flat - flat.mean(1, keepdims=True)
    flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-6)
    return flat @ flat.T
