"""Procedural textures: functions of a `Canvas` and a few colours; no image files.

Each returns sRGB values in [0, 1], float64 ``[n, n, 3]``; row 0 is the top. Those of `surfaces` repeat seamlessly.
"""

from collections.abc import Callable

from dirl.sources.rooms.mesh import functions_of
from dirl.sources.rooms.textures import artwork, surfaces
from dirl.sources.rooms.textures.noise import Array

TEXTURES: dict[str, Callable[..., Array]] = functions_of(surfaces, artwork)
"""The textures by the names that room descriptions use (`kind` of a material)."""
