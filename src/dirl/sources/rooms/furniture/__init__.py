"""Furniture: functions from a size and a few options to a `Mesh`.

A piece stands with the middle of its footprint at the origin, on the floor, z = 0, and its front faces -y. Sizes are
width, depth, height in metres; an option that is a text is the name of a material, unless it says otherwise. Hanging
pieces have their back at depth / 2, and ``z`` says how high they hang.
"""

from collections.abc import Callable

from dirl.sources.rooms.furniture import details, fixtures, standing
from dirl.sources.rooms.mesh import Mesh, functions_of

FURNITURE: dict[str, Callable[..., Mesh]] = functions_of(fixtures, standing, details)
"""The kinds of furniture, by the names that room descriptions use."""

NOT_SOLID = {
    *("picture", "mirror", "window", "door", "towel_rail", "wall_cupboard", "hood", "ceiling_lamp"),
    *("rug", "bottles", "bowl", "vase", "tv"),
}
"""Kinds that do not stand in an agent's way: they hang, lie flat, or stand on something that does."""
