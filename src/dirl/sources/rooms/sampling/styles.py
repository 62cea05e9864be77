"""The style of a random room: matching colours, and materials made of them."""

import colorsys
from dataclasses import replace

import numpy as np

from dirl.sources.rooms.description import SIDES, Band, Material
from dirl.sources.rooms.materials import STOCK
from dirl.sources.rooms.sampling.splits import EVERYTHING, Repertoire

HUES = ((0.0, 0.4, 0.55, 0.65, 0.85, 0.92, 1.0), (0.0, 0.14, 0.3, 0.48, 0.64, 0.85, 1.0))
"""Quantiles of the hues that are sampled: shares, and hues (red 0, yellow 0.17, green 0.33, blue 0.67)."""


class Style:
    """Colours and materials of one room. Every method that makes a material adds it, and returns its name."""

    def __init__(self, rng: np.random.Generator, *, wet: bool, repertoire: Repertoire = EVERYTHING) -> None:
        self.rng, self.wet, self.repertoire = rng, wet, repertoire
        self.materials: dict[str, Material] = {}
        # Two neighbouring hues for most of the room and one far from them: rooms with all hues look alike. People
        # paint warm or blue more often than green or purple, which are half of the circle of hues.
        hue, apart = float(np.interp(rng.random(), *HUES)), rng.uniform(0.03, 0.12)
        self.hues = [hue, (hue + apart) % 1, (hue + rng.uniform(0.4, 0.6)) % 1]
        self.vivid = rng.uniform(0.2, 0.6)
        for name, wood in zip(("wood", "wood_dark", "wood_c"), rng.permutation(list(repertoire.woods)), strict=False):
            self._add_wood(name, *repertoire.woods[wood])
        self._add_wood("door", *self._one_wood("birch", "oak", "teak", "walnut", "limed"))
        self._recolor()

    def add(self, material: Material, prefix: str) -> str:
        """Keep a material under a new name."""
        name = f"{prefix}_{sum(known.startswith(prefix) for known in self.materials)}"
        self.materials[name] = replace(material, seed=int(self.rng.integers(1 << 30)))
        return name

    def color(self, *, hue: float | None = None, saturation: float | None = None, value: float | None = None) -> str:
        """Return a colour of the room's palette, a little off; what is not given is sampled."""
        base = float(self.rng.choice(self.hues, p=(0.45, 0.35, 0.2))) if hue is None else hue
        s = self.vivid * self.rng.uniform(0.5, 1.0) if saturation is None else saturation
        v = self.rng.uniform(0.35, 0.85) if value is None else value
        red, green, blue = colorsys.hsv_to_rgb((base + self.rng.normal(0, 0.02)) % 1, s, v)
        return f"#{round(red * 255):02x}{round(green * 255):02x}{round(blue * 255):02x}"

    def colors(self, count: int) -> tuple[str, ...]:
        """Return several colours, from dark to light, of all hues of the palette."""
        values = np.linspace(0.3, 0.9, count)
        return tuple(self.color(hue=self.hues[k % 3], value=float(value)) for k, value in enumerate(values))

    def wood(self) -> str:
        """Choose one of the room's three woods, or now and then painted wood."""
        if self.rng.random() < 0.25:
            return self.add(Material("plain", {"color": self.color(), "var": 0.06}, rough=0.4, resolution=128), "paint")
        return str(self.rng.choice(["wood", "wood_dark", "wood_c"]))

    def cloth(self, value: float | None = None) -> str:
        """Return a fabric of one colour, striped or checked."""
        color, kind = self.color(value=value), self.rng.random()
        options: dict[str, object] = {"color": color, "color2": self.color(saturation=0.15, value=0.85)}
        if kind < 0.35:
            options["stripes"] = int(self.rng.integers(4, 11))
        elif kind < 0.5:
            checks = {"color": color, "checks": int(self.rng.integers(3, 8))}
            return self.add(Material("gingham", checks, size=0.6, rough=0.95), "cloth")
        return self.add(Material("fabric", options, size=self.rng.uniform(0.5, 0.9), rough=0.95), "cloth")

    def worktop(self) -> str:
        """Choose stone or wood for a worktop."""
        if self.rng.random() < 0.3:
            return self.wood()
        light = self.rng.random() < 0.6
        a, b = ("#f1eee8", self.color(saturation=0.1, value=0.5)) if light else ("#35383d", "#8b9098")
        scale = int(self.rng.integers(2, 9))
        return self.add(Material("marble", {"a": a, "b": b, "scale": scale}, rough=0.14), "stone")

    def rug(self) -> str:
        """Return a rug."""
        kind = str(self.rng.choice(self.repertoire.rugs))
        dark, ornament, border, line = self.colors(4)
        return self.add(Material(kind, {"colors": (dark, line, border, ornament)}, size=0, rough=1.0), "rug")

    def painting(self) -> str:
        """Return a picture unlike any other in the room."""
        kind = str(self.rng.choice(self.repertoire.paintings))
        options: dict[str, object] = (
            self._scenery(kind) if kind in ("landscape", "skyline", "sea") else {"colors": self._bold()}
        )
        if kind == "bouquet":
            options["ground"] = self.color(value=self.rng.uniform(0.2, 0.7))
        if kind == "abstract":
            options["cells"] = int(self.rng.integers(6, 30))
        if kind == "circles":
            options["cells"] = int(self.rng.integers(2, 5))
        return self.add(Material(kind, options, size=0), "art")

    def outlook(self) -> str:
        """Return what a window shows; it lights the room."""
        shares = np.array(list(self.repertoire.outlooks.values()))
        kind = str(self.rng.choice(list(self.repertoire.outlooks), p=shares / shares.sum()))
        light = self.rng.uniform(2.6, 3.8)
        return self.add(Material(kind, self._scenery(kind), size=0, emit=light, glow=1.5), "outlook")

    def walls(self, height: float) -> dict[str, tuple[Band, ...]]:
        """Choose four walls, some with a dado, each with another pattern as long as there are enough."""
        patterns = [str(p) for p in self.rng.permutation(self.repertoire.wallpapers)]
        dado, dado_height = self.rng.random() < (0.7 if self.wet else 0.4), float(self.rng.choice([0.9, 1.0, 1.2, 1.5]))
        walls: dict[str, tuple[Band, ...]] = {}
        order = self.rng.permutation([0, 0, 1, 2 if self.rng.random() < 0.5 else 1])
        for k, side in enumerate(SIDES):
            hue = self.hues[int(order[k])]
            if self.wet and self.rng.random() < 0.25:
                walls[side] = ((height, self._tiles(hue)),)
                continue
            paper = self.paper(patterns[k % len(patterns)], hue)
            if dado and self.rng.random() < 0.75:
                foot = self._tiles(hue) if self.wet else self._panel()
                walls[side] = ((dado_height, foot), (height, paper))
            elif not self.wet and self.rng.random() < 0.12:
                walls[side] = ((height, "brick"),)
            else:
                walls[side] = ((height, paper),)
        return walls

    def floor(self) -> str:
        """Choose boards or parquet, or where it is wet tiles."""
        kinds = self.repertoire.wet_floors if self.wet else self.repertoire.floors
        kind, size = str(self.rng.choice(kinds)), self.rng.uniform(1.6, 2.4)
        if kind in ("planks", "herringbone"):
            a, b = self._one_wood("oak", "teak", "walnut", "ash", "mahogany", "birch")
            rows = int(self.rng.integers(5, 10))
            material = Material(kind, {"a": a, "b": b, "rows": rows}, rough=0.3, size=size, resolution=1024)
        elif kind == "terrazzo":
            options: dict[str, object] = {"ground": self.color(saturation=0.1, value=0.85), "colors": self.colors(4)}
            material = Material(kind, options, rough=0.25, size=1.4, resolution=1024)
        else:
            light, dark = self.color(saturation=0.12, value=0.88), self.color(saturation=0.4, value=0.5)
            colors: tuple[str, ...] = (light, dark)
            if kind == "tile":
                colors = (dark, *[self.color(saturation=0.3, value=value) for value in (0.58, 0.66, 0.74)])
            n = 2 * int(self.rng.integers(2, 4))
            options = {"colors": colors, "checker": kind == "checker", "nx": n, "ny": n, "grout": light}
            material = Material("tile", options, rough=0.25, size=size, resolution=1024)
        return self.add(material, "floor")

    def _one_wood(self, *names: str) -> tuple[str, str]:
        """Return the colours of one of some woods that is in the repertoire."""
        woods = self.repertoire.woods
        return woods[str(self.rng.choice([name for name in names if name in woods]))]

    def _add_wood(self, name: str, a: str, b: str) -> None:
        size, rough, seed = self.rng.uniform(0.7, 1.2), self.rng.uniform(0.35, 0.5), int(self.rng.integers(1 << 30))
        self.materials[name] = Material("wood", {"a": a, "b": b}, seed=seed, size=size, rough=rough)

    def _recolor(self) -> None:
        """Give things in stock the room's own colours."""
        for name in ("accent", "pot", "towel_a", "towel_b", "sofa", "fruit"):
            stock = STOCK[name]
            color = self.color(value=self.rng.uniform(0.45, 0.8))
            self.materials[name] = replace(stock, options={**stock.options, "color": color})
        for name in ("books", "leaf", "screen", "marble"):
            self.materials[name] = replace(STOCK[name], seed=int(self.rng.integers(1 << 30)))
        if self.rng.random() < 0.4:
            self.materials["chrome"] = STOCK["brass"]
        if self.rng.random() < 0.5:
            warm = self.color(hue=0.1, saturation=self.rng.uniform(0.02, 0.12), value=0.93)
            self.materials["ceiling"] = replace(STOCK["ceiling"], options={"color": warm, "var": 0.03})

    def paper(self, kind: str, hue: float) -> str:
        """Choose wallpaper, or cloth printed like it."""
        dark = self.rng.random() < 0.25
        ground = self.color(hue=hue, saturation=0.5 if dark else 0.14, value=0.42 if dark else 0.9)
        motif = self.color(hue=hue, saturation=0.35, value=0.68 if dark else 0.6)
        options: dict[str, object] = {"ground": ground, "motif": motif, "accent": self.color(value=0.55)}
        if kind == "leaf":
            options["leaves"] = int(self.rng.integers(28, 48))
        elif kind == "damask":
            options["nx"] = int(self.rng.integers(3, 5))
        else:
            options["nx"] = int(self.rng.integers(4, 8))
        return self.add(Material(kind, options, size=self.rng.uniform(1.1, 1.7), rough=0.9), "paper")

    def _tiles(self, hue: float) -> str:
        colors = [self.color(hue=hue, saturation=self.rng.uniform(0.05, 0.4), value=self.rng.uniform(0.45, 0.95))
                  for _ in range(int(self.rng.integers(2, 5)))]  # fmt: skip
        nx, ny, brick = self.repertoire.tiles[self.rng.integers(len(self.repertoire.tiles))]
        options = {"colors": tuple(colors), "nx": nx, "ny": ny, "brick": brick, "grout": "#d5d2ca"}
        return self.add(Material("tile", options, size=1.25, rough=0.14), "tiles")

    def _panel(self) -> str:
        a, b = self._one_wood("birch", "walnut", "limed", "teak")
        return self.add(Material("planks", {"a": a, "b": b, "rows": 8}, size=1.2, rough=0.45), "panel")

    def _bold(self) -> tuple[str, ...]:
        """Return colours of a painting: of any hue, dark to light."""
        values = np.linspace(0.25, 0.95, 5)
        hues = np.interp(self.rng.random(5), *HUES)
        return tuple(
            self.color(hue=float(hue), saturation=self.rng.uniform(0.2, 0.75), value=float(v))
            for hue, v in zip(hues, values, strict=True)
        )

    def _scenery(self, kind: str) -> dict[str, object]:
        sky = self.repertoire.skies[self.rng.integers(len(self.repertoire.skies))]
        if kind == "landscape":
            ground, far = self.color(hue=self.rng.uniform(0.1, 0.4), value=0.45), self.color(value=0.7, saturation=0.2)
            return {"sky": sky, "hills": int(self.rng.integers(3, 7)), "ground": ground, "far": far}
        if kind == "skyline":
            return {"sky": sky, "colors": tuple(self.color(saturation=0.25, value=v) for v in (0.4, 0.55, 0.7))}
        water = self.color(hue=self.rng.uniform(0.48, 0.6), saturation=0.6, value=0.55)
        return {"sky": sky, "water": water, "shore": self.color(hue=0.11, saturation=0.35, value=0.8)}
