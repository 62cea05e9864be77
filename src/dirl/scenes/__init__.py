"""What an agent walks in: scenes, the worlds made of them, and the files that hold them."""

from dirl.scenes.catalogue import PUBLISHED_GOALS, load_scenes
from dirl.scenes.graph import ACTIONS, GraphError
from dirl.scenes.io.read import SceneWarning, read_dump
from dirl.scenes.io.write import write_dump
from dirl.scenes.scene import Scene, SceneError
from dirl.scenes.views import Views
from dirl.scenes.world import World, make_world

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
