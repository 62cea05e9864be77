"""Training, validation and test rooms: their seeds, and the stock of furnishings that each split uses.

- Seeds 0 to 9,999 belong to no split and use everything.
- Seeds 10,000 to 19,999 are test rooms, which use `TEST`.
- Seeds 20,000 to 29,999 are validation rooms, which use `TRAIN`.
- Seeds from 30,000 on are training rooms, which use `TRAIN`.

`TRAIN` and `TEST` have no wood, sky, wallpaper, picture, window outlook, rug, floor, tile layout or potted plant, vase
and set of bottles (a piece's own ``seed``) in common. They share the shapes of furniture (the same functions, each time
with other sizes and options), the fabrics' weaves, the range of colours, the sizes of rooms, the rules of furnishing,
and the plain materials of stock: paint, ceramic, metal, marble, brick, wicker.
"""

from dataclasses import dataclass
from typing import Any

from dirl.scenes.catalogue import split_of

Colors = tuple[str, str]
Tiling = tuple[int, int, bool]


@dataclass(frozen=True)
class Repertoire:
    """The stock that a random room may use.

    Args:
        woods: dark and light colour of the grain, by name.
        skies: colours above and at the horizon.
        wallpapers: kinds of texture.
        paintings: likewise.
        outlooks: what windows show, with the fraction of each.
        rugs: kinds of texture.
        floors: likewise; a kind named twice is sampled twice as often.
        wet_floors: likewise, of bathrooms and kitchens.
        tiles: columns and rows of tiles, and whether they are laid like bricks.
        seeds: of pieces that are sampled at random themselves: the first, and the one after the last.
    """

    woods: dict[str, Colors]
    skies: tuple[Colors, ...]
    wallpapers: tuple[str, ...]
    paintings: tuple[str, ...]
    outlooks: dict[str, float]
    rugs: tuple[str, ...]
    floors: tuple[str, ...]
    wet_floors: tuple[str, ...]
    tiles: tuple[Tiling, ...]
    seeds: tuple[int, int]


EVERYTHING = Repertoire(
    woods={
        "birch": ("#c9a97c", "#ead7b5"),
        "oak": ("#9a6b3f", "#d6ab74"),
        "teak": ("#7a4a26", "#b77b45"),
        "walnut": ("#4a2d1b", "#835838"),
        "mahogany": ("#4b1f16", "#8a4130"),
        "ebony": ("#211a16", "#4a3d34"),
        "ash": ("#8f8371", "#cfc4b0"),
        "limed": ("#8f7f63", "#eee5d2"),
    },
    skies=(
        ("#5f9fd6", "#f6dfbf"),
        ("#7fb2e5", "#fbe3c0"),
        ("#9fb4c4", "#e4e6e4"),
        ("#4d7fc0", "#f4f0e6"),
        ("#6a6fb5", "#f2b28c"),
        ("#86a9c9", "#f7d6d0"),
    ),
    wallpapers=("damask", "stripe", "leaf", "dots", "trellis", "chevron"),
    paintings=("abstract", "blocks", "circles", "bouquet", "landscape", "skyline", "sea"),
    outlooks={"landscape": 0.5, "skyline": 0.3, "sea": 0.2},
    rugs=("rug", "kilim"),
    floors=("planks", "planks", "herringbone", "tile"),
    wet_floors=("tile", "checker", "terrazzo"),
    tiles=((6, 12, True), (8, 8, False), (12, 12, False), (5, 5, False)),
    seeds=(0, 1000),
)

HELD_OUT = {
    "woods": ("teak", "mahogany", "limed"),
    "skies": EVERYTHING.skies[4:],
    "wallpapers": ("trellis", "chevron"),
    "paintings": ("blocks", "circles", "sea"),
    "outlooks": ("sea",),
    "rugs": ("kilim",),
    "floors": ("herringbone",),
    "wet_floors": ("terrazzo",),
    "tiles": ((5, 5, False),),
}
"""Of each part of the repertoire, what only the test rooms show."""


def _repertoire(*, held_out: bool) -> Repertoire:
    parts: dict[str, Any] = {}
    for part, names in HELD_OUT.items():
        choices = getattr(EVERYTHING, part)
        kept = [choice for choice in choices if (choice in names) == held_out]
        parts[part] = {name: choices[name] for name in kept} if isinstance(choices, dict) else tuple(kept)
    return Repertoire(**parts, seeds=(800, 1000) if held_out else (0, 800))


TRAIN, TEST = _repertoire(held_out=False), _repertoire(held_out=True)


def repertoire_of(seed: int) -> Repertoire:
    """Return the stock that the rooms of a seed may use."""
    split = split_of(seed)
    return EVERYTHING if split is None else TEST if split == "test" else TRAIN
