"""A scene as other cameras see it: tilted, zoomed, distorted, compressed, small, in other light, covered, blurred.

    python examples/other_cameras.py scene=bathroom_02 change=tilt out=tilted.h5
    python recipes/evaluate.py checkpoint=general scene=tilted.h5 goals=every:9 starts=sampled \
        episodes_per_goal=3 max_steps=100

Every look has errors, and no visit shows the look of its goal. All views from a place share the errors of a visit, but
each is covered elsewhere.
"""

import io
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image

from dirl.cli.start import run, start
from dirl.config.schemas import option
from dirl.perception.backbones import encode_all, load_encoder
from dirl.perception.backbones.encoder import reduced
from dirl.scenes.catalogue import load_scenes
from dirl.scenes.io.write import write_dump
from dirl.scenes.views import encode

FIELD_OF_VIEW = 75.0
"""Degrees, of the built-in rooms."""

PIXELS = 64
"""Width to which `general` reduces views, ``network.pixels``; only features are stored, so it is done here."""

Pixels = NDArray[np.uint8]


@dataclass
class Options:
    """Which camera."""

    scene: str = option("a built-in scene, or a dump with views")
    change: str = option("tilt | zoom | barrel | jpeg | small | light | cover | blur")
    out: str = option("the dump to write (.h5)")
    looks: int = option("of each state", 6)
    seed: int = option("of the errors", 0)


def seen_through(
    view: Pixels, *, tilt: float = 0.0, roll: float = 0.0, zoom: float = 1.0, barrel: float = 0.0
) -> Pixels:
    """Return a view ``[H, W, 3]`` as a turned, zoomed or distorted camera takes it; its edge fills what was not seen.

    Args:
        view: by a camera of `FIELD_OF_VIEW` degrees.
        tilt: of the camera upwards, degrees.
        roll: to its left, degrees.
        zoom: its focal length over that of the first camera.
        barrel: of a distortion by ``1 + barrel * r ** 2``, r = 1 at the left and right edge.
    """
    height, width = view.shape[:2]
    edge = np.tan(np.radians(FIELD_OF_VIEW / 2))
    across, down = np.meshgrid(*(np.arange(size) - (size - 1) / 2 for size in (width, height)))
    across, down = across * 2 * edge / width / zoom, down * 2 * edge / width / zoom
    stretch = 1 + barrel * (across**2 + down**2) / edge**2
    rays = np.stack([across * stretch, down * stretch, np.ones_like(across)], -1)
    turned, _ = cv2.Rodrigues(np.radians([tilt, 0.0, 0.0]))
    rolled, _ = cv2.Rodrigues(np.radians([0.0, 0.0, roll]))
    right, below, ahead = np.moveaxis(rays @ rolled.T @ turned.T, -1, 0)
    columns = right / ahead * width / 2 / edge + (width - 1) / 2
    rows = below / ahead * width / 2 / edge + (height - 1) / 2
    maps = columns.astype(np.float32), rows.astype(np.float32)
    return cv2.remap(view, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def compressed(view: Pixels, quality: int) -> Pixels:
    """Return a view as a JPEG of this quality shows it."""
    stream = io.BytesIO()
    Image.fromarray(view).save(stream, "JPEG", quality=quality)
    return np.array(Image.open(stream))


def lit(view: Pixels, rng: np.random.Generator) -> Pixels:
    """Return a view in brighter or darker light with a tint, by a camera of another gamma."""
    gain, gamma = np.exp(rng.normal(0, 0.2) + rng.normal(0, 0.05, 3)), np.exp(rng.normal(0, 0.2))
    return np.rint(255 * np.clip((view / 255) ** gamma * gain, 0, 1)).astype(np.uint8)


def covered(view: Pixels, rng: np.random.Generator) -> Pixels:
    """Return a view of which a rectangle of one colour covers a fifth."""
    height, width = view.shape[:2]
    wide = round(width * rng.uniform(0.25, 0.8))
    high = round(height * width / 5 / wide)
    top, left = rng.integers(height - high + 1), rng.integers(width - wide + 1)
    shown = view.copy()
    shown[top : top + high, left : left + wide] = rng.integers(256, size=3)
    return shown


def blurred(view: Pixels, _: np.random.Generator) -> Pixels:
    """Return a view blurred along its rows, by 7 pixels in 64."""
    return cv2.blur(view, (max(1, view.shape[1] * 7 // 64), 1))


CHANGES: dict[str, Callable[[Pixels, np.random.Generator], Pixels]] = {
    "tilt": lambda view, rng: seen_through(view, tilt=rng.normal(0, 3), roll=rng.normal(0, 3)),
    "zoom": lambda view, rng: seen_through(view, zoom=rng.uniform(0.9, 1.1)),
    "barrel": lambda view, rng: seen_through(view, barrel=rng.uniform(-0.1, 0.1)),
    "jpeg": lambda view, rng: compressed(view, int(rng.integers(30, 51))),
    "small": lambda view, rng: cv2.resize(view, None, fx=(scale := rng.uniform(0.2, 0.5)), fy=scale),
    "light": lit,
    "cover": covered,
    "blur": blurred,
}


def main(scene: str, change: str, out: str, looks: int, seed: int) -> None:
    """Write the scene."""
    if change not in CHANGES:
        raise ValueError(f"change={change}: choose from {', '.join(CHANGES)}")
    room, *_ = load_scenes(scene)
    if room.views is None:
        raise ValueError(f"scene={scene}: has no views to change")
    encoder = load_encoder("efficientnet_lite0", patches=True, fine_patches=True)
    views = [np.asarray(view) for view in room.views]
    size = views[0].shape[1::-1]
    _, place = np.unique(room.positions, axis=0, return_inverse=True)

    def visits() -> Iterator[Pixels]:
        for look in range(looks):
            for state, (view, at) in enumerate(zip(views, place, strict=True)):
                drawn = np.random.default_rng([seed, look, state if change == "cover" else at])
                seen = cv2.resize(CHANGES[change](view, drawn), size)
                yield reduced(torch.from_numpy(seen)[None], PIXELS)[0].numpy()

    features, patches = encode_all(encoder, visits(), looks * len(room), out)
    first, *others = np.split(features.astype(np.float16), looks)
    first_patches, *other_patches = np.split(patches, looks)
    made = replace(
        room,
        name=f"{room.name}_{change}",
        features=first,
        look_features=np.stack(others),
        patches=first_patches,
        look_patches=np.stack(other_patches),
        extractor=encoder.extractor,
    )
    about = {"feature_attributes": encoder.attributes, "patch_attributes": encoder.patch_attributes}
    write_dump(out, made, (encode(view, 80) for view in views), **about)
    print(f"{out}: {len(room)} states in {looks} looks")


if __name__ == "__main__":
    options = start(__doc__, Options)
    run(lambda: main(**vars(options)))
