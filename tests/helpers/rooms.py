"""Small made-up rooms for the tests, in memory and as files."""

from dataclasses import replace

import h5py
import numpy as np
from forks import reading_in_process

from dirl.perception.backbones.patches import FINE, PATCH_SHAPE
from dirl.scenes import Scene, read_dump

CELL = 0.5
"""Metres between neighbouring places, as in the published dumps."""


def grid_scene(
    width=3,
    depth=2,
    *,
    name="grid",
    goals=(0,),
    feature_width=16,
    seed=0,
    headings=4,
    blocked=(),
    extractor="random",
    patches=False,
    looks=0,
    noise=0.05,
):
    """A rectangular room with one place per cell, all of them connected unless cells are blocked.

    A state's number is ``headings * place + turn``; turn 0 faces +z, and right turns go clockwise (90 degrees: +x).
    Places are numbered along x first, then z, and skip the blocked cells.

    Args:
        width, depth: cells along x and z.
        headings: turns in a full circle, a multiple of 4; ahead and back only move along the axes.
        blocked: cells ``(x, z)`` without a place, e.g. ``[(1, 0)]``.
        patches: with patches, which are random; or "fine" ones.
        looks: further looks, which are the features and patches with ``noise``.
    """
    cells = [(x, z) for z in range(depth) for x in range(width) if (x, z) not in set(blocked)]
    place_of = {cell: place for place, cell in enumerate(cells)}
    along = {0: (0, 1), 1: (1, 0), 2: (0, -1), 3: (-1, 0)}
    graph = np.full((len(cells) * headings, 4), -1, np.int64)
    for (x, z), place in place_of.items():
        first = headings * place
        for turn in range(headings):
            graph[first + turn, 1] = first + (turn + 1) % headings
            graph[first + turn, 2] = first + (turn - 1) % headings
            quarter, rest = divmod(turn, headings // 4)
            if rest == 0:
                dx, dz = along[quarter]
                for action, sign in ((0, 1), (3, -1)):
                    beside = place_of.get((x + sign * dx, z + sign * dz))
                    if beside is not None:
                        graph[first + turn, action] = headings * beside + turn
    rng = np.random.default_rng(seed)
    features = rng.random((len(graph), feature_width), np.float32)
    shape = (FINE[0] * FINE[1], PATCH_SHAPE[1]) if patches == "fine" else PATCH_SHAPE
    parts = rng.normal(size=(len(graph), *shape)).astype(np.float16) if patches else None

    def again(values):
        if values is None or not looks:
            return None
        return (values + noise * rng.normal(size=(looks, *values.shape))).astype(np.float16)

    return Scene(
        name=name,
        graph=graph,
        positions=CELL * np.repeat(np.array(cells, float), headings, 0),
        headings=np.tile(np.arange(headings) * (360.0 / headings), len(cells)),
        features=features,
        goals=tuple(goals),
        extractor=extractor,
        origin="grid_scene",
        patches=parts,
        look_features=again(features),
        look_patches=again(parts),
    )


def read_here(path):
    """The scene of a file, read in this process, which takes no time; for tests of what files hold."""
    with reading_in_process():
        return read_dump(path)


def renumbered(scene, order):
    """The same room with its states numbered anew: state ``i`` of the result is state ``order[i]`` of ``scene``."""
    order = np.asarray(order)
    new_number = np.append(np.argsort(order), -1)  # the last entry keeps -1, a blocked move, as it is
    arrays = {name: getattr(scene, name)[order] for name in ("positions", "headings", "features")}
    goals = tuple(int(new_number[goal]) for goal in scene.goals)
    return replace(scene, graph=new_number[scene.graph[order]], **arrays, goals=goals, origin="renumbered")


def published_dump(path, scene, *, crops=10):
    """Write a scene as the published target-driven navigation code stores it: raw images, ten crops, no attributes.

    The features of crop 0 are the scene's; every pixel of a view is its state's number.
    """
    states = len(scene)
    others = np.full((states, crops - 1, scene.features.shape[1]), 7.0, np.float32)
    with h5py.File(path, "w") as file:
        file["graph"] = scene.graph
        file["location"] = scene.positions
        file["rotation"] = scene.headings.astype(np.int64)
        file["resnet_feature"] = np.concatenate([scene.features[:, None], others], 1)
        file["shortest_path_distance"] = scene.distances.astype(np.int64)
        file["observation"] = np.broadcast_to(np.arange(states, dtype=np.uint8)[:, None, None, None], (states, 3, 4, 3))
    return path
