"""Tours of the Zillow Indoor Dataset: ``zind_data.json`` and ``panos/``.

The file has no links: it has positions, rotations and the layouts of rooms. Two panoramas of a floor are linked if they
are near each other, and the straight line between them crosses walls only where there is a door or an opening.

Floors are not linked with each other; on the map they are drawn side by side.

Coordinates of the file run to the left and ahead of a panorama's middle; maps of dirl run to the right, metres.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from dirl.scenes.io.checked import inside
from dirl.scenes.scene import SceneError
from dirl.sources.tours.images import Equirectangular
from dirl.sources.tours.tour import MOST_PANORAMAS, Link, Panorama, Tour, entry, number, read_json, tour_text

REACH = 3.0
"""Metres between linked panoramas at most."""

APART = 3.0
"""Metres between two floors on the map."""

NEAR = 0.2
"""Metres from a wall's crossing at which a gap is: the two sides of a wall are drawn apart."""

MOST_COMPARED = 10**9
"""Pairs of panoramas, times walls, times doors of a floor."""

Array = NDArray[np.float64]


@dataclass
class _Floor:
    """What is known of a floor, in metres: walls and gaps in them are segments ``[2, 2]``."""

    standing: dict[str, tuple[Array, float, Path]] = field(default_factory=dict)
    walls: list[Array] = field(default_factory=list)
    gaps: list[Array] = field(default_factory=list)


def read_zind(file: Path, reach: float = REACH) -> Tour:
    """Return the tour that a ``zind_data.json`` describes; linked panoramas are ``reach`` metres apart at most."""
    data = read_json(tour_text(file), file)
    scales = data.get("scale_meters_per_coordinate")
    panoramas: list[Panorama] = []
    notes, edge = [], None
    for name, rooms in entry(data, "merger", dict, str(file)).items():
        scale = scales.get(name) if isinstance(scales, Mapping) else None
        if scale is None:
            notes.append(f"floor '{name}' has no scale: its lengths are heights of the camera, taken for 1.5 m")
        metres = 1.5 if scale is None else number(scale, f"{file}: scale of '{name}'", 1e-3, 1e3)
        floor = _Floor()
        for room, parts in _objects(rooms, f"{file}: {name}"):
            for part, found in _objects(parts, f"{file}: {name}: {room}"):
                for pano, about in _objects(found, f"{file}: {name}: {room}: {part}"):
                    _read_panorama(floor, f"{name}/{part}/{pano}", about, metres, file)
        if len(panoramas) + len(floor.standing) > MOST_PANORAMAS:
            raise SceneError(f"{file}: more than {MOST_PANORAMAS} panoramas; no more are read")
        across = [at[0] for at, _, _ in floor.standing.values()]
        if edge is not None and across:
            shift = edge + APART - min(across)
            notes.append(f"floor '{name}' is drawn beside the one before, {shift:.1f} m to the right of its place")
        else:
            shift = 0.0
        edge = max(across) + shift if across else edge
        panoramas += _linked(floor, reach, shift, file)
    return Tour(file.resolve().parent.name, tuple(panoramas), tuple(notes), str(file))


def _objects(values: Any, where: str) -> list[tuple[str, Mapping[str, Any]]]:
    if not isinstance(values, Mapping) or not all(isinstance(value, Mapping) for value in values.values()):
        raise SceneError(f"{where}: expected a JSON object of objects")
    return list(values.items())


def _read_panorama(floor: _Floor, name: str, about: Mapping[str, Any], metres: float, file: Path) -> None:
    where = f"{file}: {name}"
    given = entry(about, "floor_plan_transformation", dict, where)
    rotation = number(given.get("rotation"), f"{where}: rotation")
    scale = number(given.get("scale"), f"{where}: scale", 1e-3, 1e3)
    shift = _points([given.get("translation")], where)[0]
    cos, sin = np.cos(np.radians(rotation)), np.sin(np.radians(rotation))

    def on_map(points: Array) -> Array:
        turned = points @ np.array([[cos, sin], [-sin, cos]]) * scale + shift
        return turned * [-metres, metres]

    floor.standing[name] = (on_map(np.zeros((1, 2)))[0], rotation, inside(file.parent, about.get("image_path"), where))
    layout = about.get("layout_raw")
    if isinstance(layout, Mapping):
        corners = on_map(_points(layout.get("vertices"), where))
        floor.walls += list(np.stack([corners, np.roll(corners, -1, 0)], 1))
        for kind in ("doors", "openings"):  # of each the left and right end, then the heights of its two edges
            ends = _points(layout.get(kind) or [], where)
            floor.gaps += [on_map(ends[first : first + 2]) for first in range(0, len(ends) - 1, 3)]


def _points(values: Any, where: str) -> Array:
    if not isinstance(values, list) or not all(isinstance(one, list) and len(one) == 2 for one in values):
        raise SceneError(f"{where}: expected points [x, y]")
    return np.array([[number(one, where) for one in point] for point in values], float).reshape(-1, 2)


def _linked(floor: _Floor, reach: float, shift: float, file: Path) -> Iterator[Panorama]:
    """Yield the panoramas of a floor with their links, drawn ``shift`` metres to the right."""
    names, places = list(floor.standing), np.array([at for at, _, _ in floor.standing.values()]).reshape(-1, 2)
    near = KDTree(places).query_pairs(reach, output_type="ndarray") if names else np.zeros((0, 2), np.int64)
    walls, gaps = np.array(floor.walls).reshape(-1, 2, 2), np.array(floor.gaps).reshape(-1, 2, 2)
    if len(near) * (len(walls) + 1) * (len(gaps) + 1) > MOST_COMPARED:
        raise SceneError(
            f"{file}: a floor has {len(near)} pairs of panoramas within reach={reach:g} m, {len(walls)} walls and "
            f"{len(gaps)} doors, which are too many to compare; give a smaller reach"
        )
    links: dict[str, list[Link]] = {name: [] for name in names}
    for pair in sorted(near.tolist() + near[:, ::-1].tolist()):
        here, there = pair
        way = places[there] - places[here]
        if np.hypot(*way) > 0 and _is_free(places[here], places[there], walls, gaps):
            yaw = np.degrees(np.arctan2(*way)) - floor.standing[names[here]][1]
            links[names[here]].append(Link(names[there], float((yaw + 180) % 360 - 180)))
    for name, (at, heading, image) in floor.standing.items():
        place = (float(at[0]) + shift, float(at[1]))
        yield Panorama(name, Equirectangular(image), tuple(links[name]), place, heading % 360)


def _is_free(start: Array, end: Array, walls: Array, gaps: Array) -> bool:
    """True if the way crosses no wall, or only where a gap is; walls and gaps are ``[W, 2, 2]`` and ``[G, 2, 2]``."""
    way, along, apart = end - start, walls[:, 1] - walls[:, 0], walls[:, 0] - start
    cross = way[0] * along[:, 1] - way[1] * along[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):  # of parallels, which do not meet
        on_way = (apart[:, 0] * along[:, 1] - apart[:, 1] * along[:, 0]) / cross
        on_wall = (apart[:, 0] * way[1] - apart[:, 1] * way[0]) / cross
    met = (cross != 0) & (on_way >= 0) & (on_way <= 1) & (on_wall >= 0) & (on_wall <= 1)
    points = (start + on_way[met, None] * way)[:, None]
    # The distance of each crossing from each gap.
    gap = gaps[:, 1] - gaps[:, 0]
    share = np.clip(((points - gaps[:, 0]) * gap).sum(-1) / np.maximum((gap**2).sum(-1), 1e-12), 0, 1)
    off = points - gaps[:, 0] - share[..., None] * gap
    return bool((np.hypot(off[..., 0], off[..., 1]) <= NEAR).any(1).all())
