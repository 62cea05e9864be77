"""The camera images that a navigator accepts."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from dirl.envs.transforms import VIEWS
from dirl.scenes import ACTIONS
from dirl.scenes.graph import MAX_TURNS
from dirl.scenes.views import ANGLES, ImageError, read_photo

Images = Tensor | NDArray[np.uint8] | str | Path | Sequence[str | Path]
"""RGB pixels, uint8, or the file of a photo, or the files of an agent's views (JPEG, PNG or WebP)."""


class NavigatorError(ValueError):
    """An input that a `dirl.Navigator` cannot use; the message says why and what to do."""


def checked_images(images: Images, name: str, *, sequential: bool, views: int = VIEWS) -> tuple[Tensor, int, bool]:
    """Return one batch of images, uint8 ``[N, H, W, 3]``; the number of images an agent; whether a batch was given.

    `dirl.Navigator.reset` says what is accepted: one photo in place of four views only as ``goal_images``; and so
    many ``views`` of a panorama.

    Raises:
        NavigatorError: the images have another shape or type.
    """
    if isinstance(images, str | Path):
        images = _read(images, name)
    elif isinstance(images, list | tuple) and images and all(isinstance(file, str | Path) for file in images):
        photos = [_read(file, name) for file in images]
        shapes = {photo.shape[:2]: file for photo, file in zip(photos, images, strict=True)}
        if len(shapes) > 1:
            sizes = ", ".join(f"{file} has {width}x{height}" for (height, width), file in shapes.items())
            raise NavigatorError(f"{name}: the views of an agent are photos of one size; {sizes} pixels")
        images = np.stack(photos)
    if not isinstance(images, Tensor | np.ndarray):
        raise NavigatorError(
            f"{name}: expected an array, a tensor, or the files of photos, found {type(images).__name__}"
        )
    if isinstance(images, np.ndarray) and images.dtype != np.uint8:
        raise NavigatorError(f"{name}: expected uint8 pixels, found an array of {images.dtype}")
    # Copied, because the array of a camera driver or image library may be read-only or have negative strides.
    pixels = images if isinstance(images, Tensor) else torch.from_numpy(np.array(images, order="C"))
    shape = tuple(pixels.shape)
    accepted = _accepted(shape, sequential=sequential, goal=name == "goal_images", views=views)
    if pixels.dtype != torch.uint8 or shape[-1:] != (3,) or 0 in shape or not accepted:
        text = (
            "[H, W, 3] or [B, H, W, 3]" if sequential else "[4, H, W, 3] (ahead, right, back, left) or [B, 4, H, W, 3]"
        )
        panorama = "" if views == VIEWS else f", or a panorama's [{views}, H, W, 3] or [B, {views}, H, W, 3]"
        photo = "" if sequential or name != "goal_images" else ", or one photo [H, W, 3] or [B, 1, H, W, 3]"
        raise NavigatorError(f"{name}: expected uint8 {text}{panorama}{photo}, found {pixels.dtype} {list(shape)}")
    count = 1 if sequential or len(shape) == 3 else shape[-4]
    return pixels.reshape(-1, *shape[-3:]), count, len(shape) == (4 if sequential else 5)


def check_agents(views: Tensor, goals: int, before: Tensor | None) -> None:
    """Raise `NavigatorError` unless views ``[B, V, D]`` are of as many agents as goals, and as those a step before."""
    agents = len(views)
    if goals not in (1, agents):
        raise NavigatorError(f"images of {agents} agents for {goals} goals; give each agent a goal, or all the same")
    if before is not None and len(before) != agents:
        raise NavigatorError(f"images of {agents} agents after those of {len(before)}; call reset first")
    if before is not None and views.shape[1] not in (1, before.shape[1]):
        raise NavigatorError(f"images: {views.shape[1]} views after {before.shape[1]}; call reset first")


def check_turns(turns: Any) -> None:
    """Raise `NavigatorError` unless so many turns make a full circle and pass the four views."""
    if isinstance(turns, bool) or not isinstance(turns, int) or turns % VIEWS or not 0 < turns <= MAX_TURNS:
        raise NavigatorError(f"turns={turns!r}: expected an integer, as 4, 8 or 12")


def check_field_of_view(field_of_view: Any) -> None:
    """Raise `NavigatorError` unless this is the angle of a photo in degrees, or None."""
    least, most = ANGLES
    number = isinstance(field_of_view, int | float) and not isinstance(field_of_view, bool)
    if field_of_view is not None and not (number and least <= field_of_view <= most):
        raise NavigatorError(f"field_of_view={field_of_view!r}: expected degrees from left to right, {least} to {most}")


def check_last_steps(last_steps: Any) -> None:
    """Raise `NavigatorError` unless it is a count of steps."""
    if isinstance(last_steps, bool) or not isinstance(last_steps, int) or last_steps < 0:
        raise NavigatorError(f"last_steps={last_steps!r}: expected 0 or a positive integer")


def checked_moves(possible: Tensor | NDArray[np.bool_] | None, views: Tensor, *, batched: bool) -> Tensor | None:
    """Return which moves are possible, bool ``[B, K, 4]`` beside views ``[B, K, D]``, if that is known.

    Raises:
        NavigatorError: it has another shape or type.
    """
    if possible is None:
        return None
    of_all = [*views.shape[:2], len(ACTIONS)]
    expected, shape = of_all if batched else of_all[1:], list(np.shape(possible))
    dtype = str(getattr(possible, "dtype", type(possible).__name__)).removeprefix("torch.")
    if (dtype, shape) != ("bool", expected):
        raise NavigatorError(f"possible: expected bool {expected}, found {dtype} {shape}")
    return torch.as_tensor(possible, device=views.device).view(of_all)


def checked_features(returned: Any, rows: int, width: int, extractor: str) -> Tensor:
    """Return what an encoder gave for so many images, floats ``[rows, width]``.

    Raises:
        NavigatorError: it has another shape or type, or is not finite.
    """
    features = torch.as_tensor(returned)
    if features.shape != (rows, width) or not features.is_floating_point():
        raise NavigatorError(
            f"the encoder returned {features.dtype} {list(features.shape)} for {rows} images; the checkpoint was "
            f"trained on {width} features a view, float [{rows}, {width}]: {extractor}"
        )
    if not features.isfinite().all():
        raise NavigatorError("the encoder returned features that are not finite")
    return features


def _read(file: str | Path, name: str) -> NDArray[np.uint8]:
    try:
        return read_photo(file)
    except ImageError as error:
        raise NavigatorError(f"{name}: {error}") from None


def _accepted(shape: tuple[int, ...], *, sequential: bool, goal: bool, views: int) -> bool:
    if sequential:
        return len(shape) in (3, 4)
    if len(shape) == 3:
        return goal
    return (len(shape) in (4, 5) and shape[-4] in (VIEWS, views)) or (goal and len(shape) == 5 and shape[-4] == 1)
