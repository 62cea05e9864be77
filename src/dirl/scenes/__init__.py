"""What an agent walks in: scenes, the worlds made of them, and the files that hold them."""

from dirl.scenes.catalog import PUBLISHED_GOALS, load_scenes
from dirl.scenes.dump import SceneWarning, read_dump
from dirl.scenes.graph import ACTIONS, GraphError
from dirl.scenes.scene import Scene, SceneError
from dirl.scenes.views import Views
from dirl.scenes.world import World, make_world
from dirl.scenes.writing import write_dump

__all__ = [
    "ACTIONS",
    "PUBLISHED_GOALS",
    "GraphError",
    "Scene",
    "SceneError",
    "SceneWarning",
    "Views",
    "World",
    "load_scenes",
    "make_world",
    "read_dump",
    "write_dump",
]
