"""The pixels of panoramas: equirectangular images and tiled cubes, and the views that are cut out of them.

py360convert would do the cutting, but reads cubes by way of an equirectangular image.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from dirl.scenes.scene import SceneError
from dirl.scenes.views import encode, open_photo, to_rgb

MAX_FACE_PIXELS = 2**27
"""Pixels of a face at most; the sizes that files declare are checked before any pixel is decoded."""

MOST_LEVELS, MOST_TILES = 16, 64
"""Sizes of a cube, and tiles along a side."""

FACES = "frblud"
"""A cube's front, right, back, left, up, down. The lower edge of ``u`` and the upper one of ``d`` touch ``f``."""

Pixels = NDArray[np.uint8]


@dataclass(frozen=True)
class Equirectangular:
    """One image, twice as wide as high."""

    file: Path

    def files(self) -> Iterator[Path]:
        """Yield the files of the image."""
        yield self.file

    @property
    def count(self) -> int:
        """How many files that are."""
        return 1


@dataclass(frozen=True)
class CubeLevel:
    """The six faces of a cube at one size.

    Args:
        size: pixels a side; None if only the file tells.
        count: tiles along a side.
        path: the file of a tile, by face, row and column; a small tour can name millions of them.
    """

    size: int | None
    count: int
    path: Callable[[str, int, int], Path]

    def files(self) -> Iterator[Path]:
        """Yield the files of all faces."""
        yield from (self.path(face, y, x) for face in FACES for y in range(self.count) for x in range(self.count))


def tiled(size: int, tile: int, where: str, path: Callable[[str, int, int], Path]) -> CubeLevel:
    """Return a level of ``size`` pixels a side in tiles of ``tile`` pixels; ``path`` takes face, row and column."""
    count = -(-size // tile)
    if count > MOST_TILES:
        raise SceneError(f"{where}: {size} pixels in tiles of {tile} are more than {MOST_TILES} tiles a side")
    return CubeLevel(size, count, path)


@dataclass(frozen=True)
class Cube:
    """A cube at one or several sizes, the smallest first."""

    levels: tuple[CubeLevel, ...]

    def files(self) -> Iterator[Path]:
        """Yield the files of all sizes."""
        yield from (file for level in self.levels for file in level.files())

    @property
    def count(self) -> int:
        """How many files that are."""
        return sum(len(FACES) * level.count**2 for level in self.levels)


def six_images(path: Callable[[str], Path]) -> Cube:
    """Return a cube of one image a face."""
    return Cube((CubeLevel(None, 1, lambda face, y, x: path(face)),))


def read_panorama(image: Equirectangular | Cube, density: float) -> list[Pixels]:
    """Return the pixels of a panorama: one equirectangular ``[H, 2 H, 3]``, or six faces ``[S, S, 3]`` as `FACES`.

    ``density`` is how many pixels a radian are needed; an image that has twice as many or more is reduced. `SceneError`
    if a file cannot be read, or has another shape than it should.
    """
    if isinstance(image, Equirectangular):
        photo = open_photo(image.file, load=False)
        if abs(photo.width - 2 * photo.height) > 2:
            raise SceneError(
                f"{image.file}: {photo.width}x{photo.height} pixels; an equirectangular image is twice as wide as high"
            )
        return [_reduced(to_rgb(open_photo(image.file)), photo.width / (2 * np.pi), density)]
    enough = [level for level in image.levels if level.size is None or level.size / 2 >= density]
    level = enough[0] if enough else image.levels[-1]
    reduced, sizes = [], set()
    for face in FACES:  # one at a time, because a face may have as many pixels as memory allows
        whole = _face(level, face)
        sizes.add(whole.size)
        if len(sizes) > 1:
            raise SceneError(f"{level.path('f', 0, 0)}: the faces of this cube differ in size")
        reduced.append(_reduced(whole, whole.width / 2, density))
        del whole
    return reduced


def _face(level: CubeLevel, face: str) -> Image.Image:
    """Return a face put together from its tiles; the sizes that they declare are added up before any is decoded."""
    tiles = [[level.path(face, y, x) for x in range(level.count)] for y in range(level.count)]
    sizes = [[open_photo(file, load=False).size for file in row] for row in tiles]
    width, height = sum(tile[0] for tile in sizes[0]), sum(row[0][1] for row in sizes)
    even = all(sum(tile[0] for tile in row) == width and len({tile[1] for tile in row}) == 1 for row in sizes)
    if not even or width != (level.size or height) or width != height or width * height > MAX_FACE_PIXELS:
        wanted = "a square" if level.size is None else f"{level.size}x{level.size}"
        raise SceneError(f"{tiles[0][0]}: the tiles of face '{face}' make {width}x{height} pixels, not {wanted}")
    rows = [np.concatenate([np.asarray(to_rgb(open_photo(file))) for file in row], 1) for row in tiles]
    return Image.fromarray(np.concatenate(rows))


def _reduced(image: Image.Image, has: float, needs: float) -> Pixels:
    """Reduce an image to as many pixels a radian as are needed, so that views cut out of it do not flicker at edges."""
    factor = int(has / needs)
    return np.asarray(image.reduce(factor) if factor > 1 else image)


def density(size: tuple[int, int], field_of_view: float) -> float:
    """Return the pixels a radian in the middle of a view; its field of view is horizontal, degrees."""
    return float(size[1] / 2 / np.tan(np.radians(field_of_view / 2)))


def cut(pixels: list[Pixels], yaw: float, size: tuple[int, int], field_of_view: float) -> Pixels:
    """Return a level view out of the pixels of `read_panorama`, uint8 ``[height, width, 3]``.

    It looks ``yaw`` degrees clockwise from the middle of the image (of the front face); the field of view is
    horizontal, degrees.
    """
    return sample(pixels, _directions(np.radians(yaw), size, density(size, field_of_view)))


def sample(pixels: list[Pixels], directions: NDArray[np.float64]) -> Pixels:
    """Return what lies in some directions of a panorama, uint8 ``[H, W, 3]``, by bilinear interpolation.

    ``directions`` are unit vectors to the right of, above and ahead of its middle, float64 ``[3, H, W]``.
    """
    x, y, z = directions
    if len(pixels) == 1:
        height, width = pixels[0].shape[:2]
        across = (np.arctan2(x, z) / (2 * np.pi) + 0.5) * width - 0.5
        down = (0.5 - np.arcsin(np.clip(y, -1, 1)) / np.pi) * height - 0.5
        return _bilinear(pixels[0], across, down, wraps=True)
    sampled = np.empty((*x.shape, 3), np.uint8)
    face, right, below = _on_cube(x, y, z)
    for index, pixels_of_face in enumerate(pixels):
        here = face == index
        if here.any():
            side = len(pixels_of_face)
            places = ((where[here] + 1) / 2 * side - 0.5 for where in (right, below))
            sampled[here] = _bilinear(pixels_of_face, *places, wraps=False)
    return sampled


def _directions(yaw: float, size: tuple[int, int], focal: float) -> NDArray[np.float64]:
    """Return unit vectors of a view's pixels: right, up and ahead of the middle, float64 ``[3, height, width]``.

    The view looks ``yaw`` clockwise from the panorama's middle, radians; ``focal`` is its focal length, pixels.
    """
    height, width = size
    right, down = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(height) + 0.5 - height / 2)
    turned = np.stack([right * np.cos(yaw) + focal * np.sin(yaw), -down, focal * np.cos(yaw) - right * np.sin(yaw)])
    return turned / np.linalg.norm(turned, axis=0)


def _on_cube(x: NDArray, y: NDArray, z: NDArray) -> tuple[NDArray, NDArray, NDArray]:  # type: ignore[type-arg]
    """Return which of `FACES` each direction meets, and where: right and below its middle, -1 to 1."""
    along = np.stack([z, x, -z, -x, y, -y])
    face = along.argmax(0)
    right = np.stack([x, -z, -x, z, x, x])
    below = np.stack([-y, -y, -y, -y, z, -z])
    which = face[None]
    depth = np.take_along_axis(along, which, 0)[0]
    return face, np.take_along_axis(right, which, 0)[0] / depth, np.take_along_axis(below, which, 0)[0] / depth


def _bilinear(pixels: Pixels, across: NDArray[np.float64], down: NDArray[np.float64], *, wraps: bool) -> Pixels:
    """Return pixels at fractional columns and rows; beyond the edges the last ones, or those of the other side."""
    height, width = pixels.shape[:2]
    left, top = np.floor(across).astype(int), np.floor(down).astype(int)
    share_x, share_y = (across - left)[..., None], (down - top)[..., None]
    columns = [(left + step) % width if wraps else np.clip(left + step, 0, width - 1) for step in (0, 1)]
    rows = [np.clip(top + step, 0, height - 1) for step in (0, 1)]
    upper, lower = (pixels[row, columns[0]] * (1 - share_x) + pixels[row, columns[1]] * share_x for row in rows)
    return (upper * (1 - share_y) + lower * share_y + 0.5).astype(np.uint8)


def cut_views(
    images: Sequence[Equirectangular | Cube],
    yaws: Sequence[NDArray[np.float64]],
    *,
    size: tuple[int, int],
    field_of_view: float,
) -> Iterator[bytes]:
    """Yield the views of all panoramas, one after the other, as WebP.

    Args:
        images: of P panoramas.
        yaws: where the views of each of them look, degrees clockwise from its middle, P of float64 ``[K]``.
        size: height and width in pixels.
        field_of_view: horizontal, degrees.

    Raises:
        SceneError: an image cannot be read; raised when its turn comes.
    """
    for image, of_image in zip(images, yaws, strict=True):
        pixels = read_panorama(image, density(size, field_of_view))
        for yaw in of_image.tolist():
            yield encode(cut(pixels, yaw, size, field_of_view))
