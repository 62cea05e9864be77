"""Materials: those that every room may use, and their textures."""

import hashlib
from collections.abc import Mapping

import numpy as np

from dirl.scenes.scene import SceneError
from dirl.sources.rooms.description import Material
from dirl.sources.rooms.textures import TEXTURES
from dirl.sources.rooms.textures.noise import Array, Canvas


def _plain(color: str, rough: float, *, metal: bool = False, var: float = 0.04) -> Material:
    return Material("plain", {"color": color, "var": var}, rough=rough, metal=metal, resolution=128)


def _fabric(color: str, size: float) -> Material:
    return Material("fabric", {"color": color}, size=size, rough=0.95)


STOCK: Mapping[str, Material] = {
    "white_paint": _plain("#eceae4", 0.5),
    "ceiling": _plain("#f1efea", 0.9, var=0.03),
    "ceramic": _plain("#f3f4f2", 0.12, var=0.01),
    "appliance": _plain("#e6e7ea", 0.3, var=0.01),
    "dark": _plain("#26262a", 0.4),
    "glass_dark": _plain("#15191f", 0.06),
    "accent": _plain("#2a9d8f", 0.3),
    "pot": _plain("#b5402c", 0.3),
    "fruit": _plain("#e0a32e", 0.45),
    "rug_edge": _plain("#5d4632", 1.0),
    "chrome": _plain("#d8dade", 0.18, metal=True),
    "brass": _plain("#c9a24b", 0.25, metal=True),
    "steel": _plain("#aeb2b8", 0.35, metal=True),
    "mirror": Material("plain", {"color": "#f0f0f0"}, mirror=True, resolution=8),
    "leaf": Material("leafy", size=0, rough=0.5),
    "wood": Material("wood", rough=0.45, size=0.9),
    "wood_dark": Material("wood", {"a": "#3a2416", "b": "#6b4527"}, rough=0.4, size=0.8),
    "door": Material("wood", {"a": "#b9a184", "b": "#d9c7aa"}, rough=0.5, size=1.4),
    "marble": Material("marble", rough=0.15, size=1.2),
    "brick": Material(
        "tile",
        {"colors": ("#8f4632", "#a3573f", "#7c3a2a", "#b06a4e"), "grout": "#b7aca0", "nx": 5, "ny": 14, "brick": True},
        size=1.1,
        rough=0.9,
    ),
    "wicker": Material("fabric", {"color": "#b48a57", "color2": "#b48a57", "threads": 14}, size=0.35, rough=0.9),
    "towel_a": _fabric("#c8553d", 0.4),
    "towel_b": _fabric("#2f6690", 0.4),
    "pillow": _fabric("#e9e2d0", 0.5),
    "sofa": _fabric("#5b7065", 0.5),
    "duvet": Material("fabric", {"color": "#3d5a80", "color2": "#e0e6ee", "stripes": 6}, size=0.9, rough=0.95),
    "books": Material("books", size=0),
    "lampshade": Material("plain", {"color": "#ffe2b0", "var": 0.0}, emit=2.5, glow=1.3, resolution=8),
    "lamp": Material("plain", {"color": "#fff2df", "var": 0.0}, emit=9.0, resolution=8),
    "fire": Material("fire", size=0, emit=2.0, glow=1.4, resolution=256),
    "outdoors": Material("landscape", size=0, emit=3.2, glow=1.5),
    "screen": Material("landscape", seed=21, size=0, emit=0.4, glow=0.8),
}
"""Materials that every room may use, and describe anew under the same name."""


def paint(name: str, material: Material, limit: int = 2048) -> Array:
    """Return the texture of a material, named in its room: sRGB in [0, 1], float64 ``[n, n, 3]``.

    The material's name and seed determine every pixel; `SceneError` if an option of the texture is out of range.
    """
    digest = hashlib.sha256(f"{name}:{material.seed}".encode()).digest()
    rng = np.random.default_rng(int.from_bytes(digest[:8], "big"))
    try:
        return TEXTURES[material.kind](Canvas(rng, min(material.resolution, limit)), **material.options)
    except ValueError as error:
        raise SceneError(f"[materials] {name}: {error}") from None
