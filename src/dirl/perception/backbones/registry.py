"""The available encoders by name, and the features of many views."""

import hashlib
import math
import os
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from tqdm import tqdm

from dirl.config.components import check_choice, make, tried
from dirl.config.files import own_options
from dirl.perception.backbones.efficientnet import lite0_encoder
from dirl.perception.backbones.encoder import EncoderError, ViewEncoder, reduced, staged_encoder, weights_hash
from dirl.perception.backbones.patches import CELLS, FINE, PATCH_SIZE, load_projection, patch_attributes
from dirl.perception.backbones.resnet import (
    MEAN,
    PROVENANCE,
    SIZE,
    STD,
    ResNet50,
    fused,
    is_ignored,
    load_backbone,
    preprocess,
    shipped_backbone,
)
from dirl.scenes import Scene, SceneError, read_dump
from dirl.scenes.io.files import file_digest
from dirl.scenes.io.write import write_dump
from dirl.scenes.views import FileViews

BATCH = 32
"""Views that go through a backbone at a time."""

SHIPPED = {"resnet50": SIZE, "resnet50_small": PATCH_SIZE}
"""The encoders that come with the package, all of the same weights, and the size that views are resized to."""

LITE = "efficientnet_lite0"
"""The encoder that anybody may use; its weights are a package, see `dirl.perception.backbones.efficientnet`."""


class ImageEncoder(Protocol):
    """An image encoder of one's own: a class that a YAML file names, ``encoder=mine.yaml``, made with its options."""

    extractor: str
    """What it is, with its weights and preprocessing: scenes share a world only if theirs are equal."""

    def __call__(self, views: Tensor) -> Tensor:
        """Return features, float32 ``[B, D]``, of RGB views, uint8 ``[B, H, W, 3]``."""


class Encoded(NamedTuple):
    """What an encoder gives for N views."""

    features: NDArray[np.float32]
    """``[N, D]``."""
    patches: NDArray[np.float16] | None
    """``[N, cells, channels]``, if the encoder gives them."""


def load_encoder(
    name: str = "resnet50", device: str | torch.device = "cpu", *, patches: bool = False, fine_patches: bool = False
) -> ViewEncoder:
    """Load the encoder that a user names.

    Args:
        name: ``resnet50``, which comes with the package and made the features of the built-in rooms;
            ``resnet50_small``, the same at 96x128 pixels, a fifth of the computation; ``efficientnet_lite0``, whose
            weights are under Apache 2.0; the path of ResNet-50 weights (see
            `dirl.perception.backbones.load_backbone`); or a YAML file that names a class of one's own, see
            `ImageEncoder`.
        device: where it computes.
        patches: give patches too (`dirl.perception.backbones.patches`); encoders of the package only.
        fine_patches: six times as many (`dirl.perception.backbones.patches`), of ``efficientnet_lite0`` only.

    Raises:
        EncoderError: it cannot do that, or a package that it needs is not installed.
        ConfigError: there is no such encoder.
        ValueError: a file that holds no ResNet-50 weights.
    """
    if torch.device(device).type == "cuda" and not torch.cuda.is_available():
        raise EncoderError(f"device={device}: torch sees no CUDA device here; use device=cpu")
    if fine_patches and name != LITE:
        raise EncoderError(f"fine_patches=true: encoder={name} has none; choose encoder={LITE}")
    path = Path(name)
    if name in SHIPPED:
        return _resnet(shipped_backbone(), device, SHIPPED[name], PROVENANCE, patches=patches)
    if name == LITE:
        return lite0_encoder(device, cells=FINE if fine_patches else CELLS if patches else None)
    if patches:
        raise EncoderError(f"patches=true: encoder={name} has none; choose encoder={LITE}")
    if path.suffix == ".yaml":
        return _own_encoder(path)
    if not path.is_file() and path.suffix not in (".pth", ".pt"):
        check_choice(f"encoder '{name}'", name, [*SHIPPED, LITE, "<weights of a ResNet-50>.pth", "<your own>.yaml"])
    return _resnet(load_backbone(path), device)


def _own_encoder(file: Path) -> ViewEncoder:
    """Make the encoder whose class a user's YAML file names, see `ImageEncoder`, and try it on a grey view.

    Raises:
        ConfigError: it cannot be made, does not describe itself, or gives something else than features.
    """
    encoder = make("image_encoder", own_options("encoder", file))
    if not isinstance(getattr(encoder, "extractor", None), str) or not callable(encoder):
        raise EncoderError(f"encoder={file}: {type(encoder).__name__} has no text extractor, or cannot be called")

    def forward(views: Tensor) -> Tensor:
        with torch.inference_mode(), tried(f"encoder={file}", encoder):
            features = encoder(views)
            if not isinstance(features, Tensor) or features.ndim != 2 or len(features) != len(views):
                shape = list(features.shape) if isinstance(features, Tensor) else type(features).__name__
                raise TypeError(f"gave {shape} for views {list(views.shape)}; expected features [B, D]")
            return features.float()

    forward(torch.full((1, 64, 64, 3), 127, dtype=torch.uint8))
    return ViewEncoder(forward, {"extractor": encoder.extractor})


def packaged_encoder(extractor: str) -> str | None:
    """Return the name of the package's encoder with this description (`Scene.extractor`); None if none has it."""
    families = {"EfficientNet-Lite0": [LITE], "ResNet-50": [*SHIPPED]}
    names = next((names for family, names in families.items() if extractor.startswith(family)), [])
    return next((name for name in names if load_encoder(name).extractor == extractor), None)


def encoded_as(scene: Scene, extractor: str, *, patches: bool, pixels: int | None = None) -> Scene:
    """Encode a scene's views by an encoder of the package; return the scene as it is if that is not possible.

    ``extractor`` describes the encoder, see `Scene.extractor`; ``patches`` says whether they are needed too, and
    ``pixels`` to what width views are `reduced`. The result is kept in the folder ``dirl`` of the user's cache
    (``XDG_CACHE_HOME``, else ``~/.cache``), if that can be written.
    """
    along = scene.along if scene.extractor == extractor else None  # a file has no views to encode them anew
    if scene.views is None:
        return scene
    # In a tour no network reads what is likened to the goal: the sharper the better. Of looks there are no views.
    if scene.source.startswith("tour") or scene.looks > 1 or scene.views[0].shape[1] <= (pixels or math.inf):
        pixels = None
    if scene.extractor == extractor and (scene.patches is not None or not patches) and pixels is None:
        return scene
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")  # "~" itself where nobody has a home
    kept = None
    if isinstance(scene.views, FileViews):
        wanted = f"{file_digest(scene.views.path)} {extractor} {patches} {pixels}"
        kept = Path(home) / "dirl" / f"{scene.name}_{hashlib.sha256(wanted.encode()).hexdigest()[:16]}.h5"
        with suppress(SceneError, OSError):  # what is missing, damaged or of another encoder is made anew
            dump = read_dump(kept)
            if dump.extractor == extractor and len(dump) == len(scene) and (dump.patches is not None or not patches):
                return replace(scene, features=dump.features, patches=dump.patches, along=along, extractor=extractor)
    name = packaged_encoder(extractor)  # compares weights, which takes longer than reading what was kept
    if name is None:
        return scene
    if kept is not None:
        print(f"{scene.name}: its views are encoded with {name}, once; kept in {kept.parent}", flush=True)
    fine = patches and name == LITE  # single photos are recognised by them
    encoder = load_encoder(name, patches=patches, fine_patches=fine)
    views = (reduced(torch.tensor(scene.views[state])[None], pixels)[0].numpy() for state in range(len(scene)))
    features, parts = encode_all(encoder, views, len(scene), scene.origin)
    encoded = replace(scene, features=features, patches=parts, along=along, extractor=extractor)
    if kept is None:
        return encoded
    try:
        if home.startswith("~"):
            raise SceneError("this user has no home directory; XDG_CACHE_HOME names a folder")
        plain = Scene(scene.name, scene.graph, scene.positions, scene.headings, features, patches=parts)
        write_dump(kept, plain, feature_attributes=encoder.attributes, patch_attributes=encoder.patch_attributes)
    except (SceneError, OSError) as error:
        print(f"not kept: {error}", flush=True)
    return encoded


def encode_all(
    encoder: ViewEncoder, views: Iterable[NDArray[np.uint8]], count: int, origin: str, *, progress: bool = True
) -> Encoded:
    """Return the features of views, and patches if the encoder gives them.

    Args:
        encoder: whose.
        views: RGB, uint8 ``[H, W, 3]`` each; they are taken one batch at a time.
        count: how many there are, N.
        origin: named in errors, with the state, which is the view's place among them.
        progress: show a progress bar.

    Raises:
        EncoderError: a view has another shape than the first, or gets features that are not finite.
    """
    remaining = iter(views)
    features: list[NDArray[np.float32]] = []
    patches: list[NDArray[np.float16]] = []
    shape: tuple[int, ...] = ()
    with tqdm(total=count, desc="encode", unit=" views", disable=None if progress else True) as bar:
        while batch := list(islice(remaining, BATCH)):
            first = BATCH * len(features)
            shape = shape or batch[0].shape
            for state, view in enumerate(batch, first):
                if view.shape != shape:
                    raise EncoderError(f"{origin}: state {state} has a view {view.shape}, state 0 one {shape}")
            images = torch.from_numpy(np.stack(batch))
            if encoder.forward_patches is None:
                pooled = encoder(images)
            else:
                pooled, cells = encoder.forward_patches(images)
                patches.append(cells.cpu().numpy().astype(np.float16))
            features.append(pooled.float().cpu().numpy())
            bad = np.flatnonzero(~np.isfinite(features[-1]).all(1))
            if len(bad):
                raise EncoderError(f"{origin}: state {first + bad[0]}: its features are not finite numbers")
            bar.update(len(batch))
    return Encoded(np.concatenate(features), np.concatenate(patches) if patches else None)


def _resnet(
    backbone: ResNet50,
    device: str | torch.device,
    size: tuple[int, int] = SIZE,
    provenance: str = "",
    *,
    patches: bool = False,
) -> ViewEncoder:
    parameters = {name: value for name, value in backbone.state_dict().items() if not is_ignored(name)}
    attributes = {
        "extractor": "ResNet-50, global average pool",
        "preprocessing": f"RGB resized to {size[0]}x{size[1]} bilinear (Pillow), /255, mean {MEAN}, std {STD}",
        "weights": weights_hash(parameters),
    }
    quick = fused(backbone).to(device).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    attributes |= {"provenance": provenance} if provenance else {}
    stage = partial(_third_stage, quick, size, device)
    if not patches:
        return staged_encoder(stage, quick.pool, attributes)
    projection = load_projection(device)
    if size == PATCH_SIZE:
        return staged_encoder(stage, quick.pool, attributes, projection, patch_attributes())
    # Patches are of smaller views, which go through the network, too.
    small = partial(_third_stage, quick, PATCH_SIZE, device)
    alone = staged_encoder(stage, quick.pool, attributes)
    return ViewEncoder(alone.forward, attributes, partial(_both, alone, small, projection), patch_attributes())


def _third_stage(network: ResNet50, size: tuple[int, int], device: str | torch.device, views: Tensor) -> Tensor:
    return network.third_stage(preprocess(views, size).to(device, memory_format=torch.channels_last))


@torch.inference_mode()
def _both(
    encoder: ViewEncoder, stage: Callable[[Tensor], Tensor], projection: Callable[[Tensor], Tensor], views: Tensor
) -> tuple[Tensor, Tensor]:
    return encoder(views), projection(stage(views))
