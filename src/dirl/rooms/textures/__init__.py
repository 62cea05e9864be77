"""Procedural textures: functions of a random generator, a size and a few colours; no image files.

Each returns sRGB values in [0, 1], float64 ``[n, n, 3]``; row 0 is the top. Those of `surfaces` repeat seamlessly.
"""

from collections.abc import Callable

from dirl.rooms.textures import outlooks, pictures, surfaces, wallpapers
from dirl.rooms.textures.noise import Array, fractal_noise, rgb

TEXTURES: dict[str, Callable[..., Array]] = {
    function.__name__: function
    for function in (
        surfaces.plain,
        surfaces.wood,
        surfaces.planks,
        surfaces.herringbone,
        surfaces.tile,
        surfaces.terrazzo,
        surfaces.marble,
        surfaces.fabric,
        surfaces.gingham,
        surfaces.leafy,
        wallpapers.damask,
        wallpapers.stripe,
        wallpapers.leaf,
        wallpapers.dots,
        wallpapers.trellis,
        wallpapers.chevron,
        pictures.abstract,
        pictures.blocks,
        pictures.circles,
        pictures.bouquet,
        pictures.rug,
        pictures.kilim,
        pictures.books,
        pictures.fire,
        outlooks.landscape,
        outlooks.skyline,
        outlooks.sea,
    )
}
"""The textures by the names that room descriptions use (`kind` of a material)."""

__all__ = ["TEXTURES", "fractal_noise", "rgb"]
