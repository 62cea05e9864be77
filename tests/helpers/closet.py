"""The smallest room that has everything, for the tests of what builds rooms."""

from dataclasses import replace

from dirl.sources.rooms import view
from dirl.sources.rooms.description import parse_description

CLOSET = """
name = "closet"
goals = [3]

[room]
size = [2.0, 1.5, 2.4]
floor = "boards"
skirting = "white_paint"

[room.walls]
north = [[1.0, "tiles"], [2.4, "paper"]]
south = "paper"
east = "brick"
west = "wood"

[grid]
origin = [0.4, 0.4]
places = 5

[materials]
boards = { kind = "planks", rows = 4, resolution = 64 }
tiles = { kind = "tile", colors = ["#3d6f95", "#e2e8e6"], nx = 4, ny = 4, resolution = 64 }
paper = { kind = "dots", motif = "#c8553d", resolution = 64 }

[[furniture]]
kind = "stool"
at = [1.5, 1.2]
size = [0.3, 0.3, 0.45]

[[furniture]]
kind = "door"
wall = "south"
along = 0.7
size = [0.7, 0.08, 2.0]

[[furniture]]
kind = "ceiling_lamp"
at = [1.0, 0.8]
size = [0.4, 0.4, 0.3]
"""


def closet(old="", new=""):
    """The room, or one that differs in a piece of its text."""
    assert old in CLOSET
    return parse_description(CLOSET.replace(old, new, 1) if old else CLOSET)


def dim_light(patch):
    """Paint rooms coarsely, light them with a few rays and look with one a pixel, where nobody looks at the light."""
    bake, scenery = view.bake, view.Scenery
    patch.setattr(view, "bake", lambda painted, **_: bake(painted, direct=1, indirect=4, bounces=1))
    patch.setattr(view, "SAMPLES", view.SAMPLES[:1])
    patch.setattr(view, "Scenery", lambda parts, materials, **_: scenery(parts, materials, edge=0.5, texture_limit=64))


def start_with_closets():
    """What a process that makes rooms begins with: closets for random rooms, papered in the seed's colour."""
    from dirl.sources.rooms import collect
    from dirl.sources.rooms.sampling.sample import look_around

    def draw(kind, seed, *, threads):
        room = replace(closet("#c8553d", f"#{seed:06d}"), name=f"{kind}_{seed}")
        return room, look_around(room)

    collect.sample_views = draw
