"""Furniture: functions from a size and a few options to a `Mesh`.

A piece stands with the middle of its footprint at the origin, on the floor, z = 0, and its front faces -y. Sizes are
width, depth, height in metres; an option that is a text is the name of a material, unless it says otherwise. Hanging
pieces have their back at depth / 2, and ``z`` says how high they hang.
"""

from collections.abc import Callable

from dirl.rooms.furniture import bathroom, bedroom, kitchen, living, openings, small, storage, tables
from dirl.rooms.mesh import Mesh

FURNITURE: dict[str, Callable[..., Mesh]] = {
    function.__name__: function
    for function in (
        bathroom.bathtub,
        bathroom.toilet,
        bathroom.vanity,
        bathroom.shower,
        bathroom.washer,
        bathroom.towel_rail,
        bedroom.bed,
        kitchen.counter,
        kitchen.fridge,
        kitchen.hood,
        kitchen.wall_cupboard,
        living.sofa,
        living.tv,
        living.fireplace,
        openings.door,
        openings.window,
        openings.picture,
        openings.mirror,
        storage.cabinet,
        storage.shelf,
        tables.table,
        tables.round_table,
        tables.chair,
        tables.stool,
        small.basket,
        small.plant,
        small.bottles,
        small.bowl,
        small.vase,
        small.rug,
        small.lamp,
        small.ceiling_lamp,
    )
}
"""The kinds of furniture, by the names that room descriptions use."""

NOT_SOLID = {
    *("picture", "mirror", "window", "door", "towel_rail", "wall_cupboard", "hood", "ceiling_lamp"),
    *("rug", "bottles", "bowl", "vase", "tv"),
}
"""Kinds that do not stand in an agent's way: they hang, lie flat, or stand on something that does."""

__all__ = ["FURNITURE", "NOT_SOLID"]
