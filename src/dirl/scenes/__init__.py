"""Scenes, the worlds made of them, and the files that hold them."""

from typing import TYPE_CHECKING

from dirl.scenes.catalogue import PUBLISHED_GOALS, load_scenes
from dirl.scenes.graph import ACTIONS, Action, GraphError
from dirl.scenes.io.read import read_dump
from dirl.scenes.io.write import write_dump
from dirl.scenes.scene import Scene, SceneError
from dirl.scenes.views import Views

if TYPE_CHECKING:
    from dirl.scenes.world import World, make_world

__all__ = [
    "ACTIONS",
    "PUBLISHED_GOALS",
    "Action",
    "GraphError",
    "Scene",
    "SceneError",
    "Views",
    "World",
    "load_scenes",
    "make_world",
    "read_dump",
    "write_dump",
]


def __getattr__(name: str) -> object:
    # Worlds need torch, whose import takes seconds; looking up a scene by its name does not.
    if name in ("World", "make_world"):
        from dirl.scenes import world

        return getattr(world, name)
    raise AttributeError(f"module 'dirl.scenes' has no attribute '{name}'")
