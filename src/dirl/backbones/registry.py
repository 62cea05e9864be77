"""Encoders to choose from: frozen backbones that turn views into features, and say exactly what they are."""

import hashlib
import json
import logging
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from tqdm import tqdm

from dirl.backbones.resnet import MEAN, SIZE, STD, ResNet50, backbone_of, encode, load_backbone
from dirl.scenes import Scene
from dirl.scenes.io.hdf5 import extractor_text

BATCH = 32
"""Views that go through a backbone at a time."""

# Of an image processor's many settings, those that change what a model sees.
RESIZING = {"do_resize", "size", "resample", "crop_pct", "do_center_crop", "crop_size"}
SCALING = {"do_rescale", "rescale_factor", "do_normalize", "image_mean", "image_std"}


class EncoderError(ValueError):
    """An encoder that cannot be had, or cannot encode these views."""


@dataclass(frozen=True)
class ViewEncoder:
    """A frozen backbone with its preprocessing. Made by `load_encoder`; also a `dirl.Navigator` takes it.

    Args:
        forward: RGB views, uint8 ``[B, H, W, 3]``, to features, float32 ``[B, D]``.
        attributes: what a dump stores of it: ``extractor``, ``preprocessing``, ``weights`` (a SHA-256 over the
            parameters that are used, whatever file they came in).
    """

    forward: Callable[[Tensor], Tensor]
    attributes: Mapping[str, str]

    @property
    def extractor(self) -> str:
        """The attributes as one text; scenes can share a world only if theirs are equal (``Scene.extractor``)."""
        return extractor_text(self.attributes)

    def __call__(self, views: Tensor) -> Tensor:
        """Features, float32 ``[B, D]``, of RGB views, uint8 ``[B, H, W, 3]``."""
        return self.forward(views)


def load_encoder(name: str, device: str | torch.device = "cpu") -> ViewEncoder:
    """The encoder that a user names.

    Args:
        name: the path of ResNet-50 weights (see `dirl.backbones.load_backbone`); ``torchvision`` for those that
            torchvision brings (IMAGENET1K_V2); or a vision backbone of Hugging Face transformers, by the name of the
            hub or a folder that holds one.
        device: where it computes.

    Raises:
        EncoderError: there is no such encoder, or a package that it needs is not installed.
        ValueError: a file that holds no ResNet-50 weights.
    """
    if torch.device(device).type == "cuda" and not torch.cuda.is_available():
        raise EncoderError(f"device={device}: torch sees no CUDA device here; use device=cpu")
    path = Path(name)
    if path.is_file() or path.suffix in (".pth", ".pt"):
        return _resnet(load_backbone(path), device)
    if name == "torchvision":
        return _resnet(_torchvision_backbone(), device)
    return _huggingface(name, device)


def encode_scene(scene: Scene, encoder: ViewEncoder) -> NDArray[np.float32]:
    """The features of every view of a scene, see `encode_views`.

    Raises:
        EncoderError: the scene has no views, or one cannot be encoded.
        ValueError: a view cannot be decoded.
    """
    if scene.views is None:
        raise EncoderError(f"{scene.origin}: has no views to encode; their dataset is observation or observation_webp")
    views = scene.views
    return encode_views(encoder, (views[state] for state in range(len(scene))), len(scene), scene.origin)


def encode_views(
    encoder: ViewEncoder, views: Iterable[NDArray[np.uint8]], count: int, origin: str
) -> NDArray[np.float32]:
    """The features of views, float32 ``[N, D]``, with a progress bar.

    Args:
        encoder: whose.
        views: RGB, uint8 ``[H, W, 3]`` each; they are taken one batch at a time.
        count: how many there are, N.
        origin: named in errors, with the state, which is the view's place among them.

    Raises:
        EncoderError: a view has another shape than the first, or gets features that are not finite.
    """
    remaining = iter(views)
    features: list[NDArray[np.float32]] = []
    shape: tuple[int, ...] = ()
    with tqdm(total=count, desc="encode", unit=" views", disable=None) as bar:
        while batch := list(islice(remaining, BATCH)):
            first = BATCH * len(features)
            shape = shape or batch[0].shape
            for state, view in enumerate(batch, first):
                if view.shape != shape:
                    raise EncoderError(f"{origin}: state {state} has a view {view.shape}, state 0 one {shape}")
            found = encoder(torch.from_numpy(np.stack(batch))).float().cpu().numpy()
            bad = np.flatnonzero(~np.isfinite(found).all(1))
            if len(bad):
                raise EncoderError(f"{origin}: state {first + bad[0]}: its features are not finite numbers")
            features.append(found)
            bar.update(len(batch))
    return np.concatenate(features)


def weights_hash(parameters: Mapping[str, Tensor]) -> str:
    """``sha256:`` and 64 digits, over the names, shapes and values (as float32) of a state_dict, in order of names."""
    digest = hashlib.sha256()
    for name in sorted(parameters):
        values = parameters[name].detach().cpu()
        values = values.float() if values.is_floating_point() else values
        digest.update(f"{name} {list(values.shape)}\n".encode())
        digest.update(values.contiguous().numpy().tobytes())
    return f"sha256:{digest.hexdigest()}"


def _resnet(backbone: ResNet50, device: str | torch.device) -> ViewEncoder:
    counters = ("num_batches_tracked",)  # of no use once training is over, and missing in some files
    parameters = {name: value for name, value in backbone.state_dict().items() if not name.endswith(counters)}
    backbone = backbone.to(device)

    @torch.no_grad()
    def forward(views: Tensor) -> Tensor:
        return encode(backbone, views, BATCH)

    return ViewEncoder(
        forward,
        {
            "extractor": "ResNet-50, global average pool",
            "preprocessing": f"RGB resized to {SIZE}x{SIZE} bilinear (Pillow), /255, mean {MEAN}, std {STD}",
            "weights": weights_hash(parameters),
        },
    )


def _torchvision_backbone() -> ResNet50:
    try:
        from torchvision.models import ResNet50_Weights
    except ImportError as error:
        raise EncoderError(
            f"encoder=torchvision: torchvision is not installed ({error}); install the one that belongs to your torch, "
            "or name a file of weights"
        ) from None
    try:
        return backbone_of(ResNet50_Weights.IMAGENET1K_V2.get_state_dict(progress=False), "torchvision")
    except OSError as error:
        raise EncoderError(f"encoder=torchvision: its weights cannot be downloaded ({error})") from None


def _huggingface(name: str, device: str | torch.device) -> ViewEncoder:
    """The mean over tokens or pixels of a model's last hidden state; every kind of backbone has one.

    (Poolers are not used: a checkpoint that was trained for classification often lacks the pooler's weights.)
    """
    try:
        from transformers import AutoImageProcessor, AutoModel
    except ImportError as error:
        raise EncoderError(
            f"encoder={name}: is no file of weights, and to look for it among Hugging Face models a package is missing "
            f"({error}): pip install 'dirl[hf]'"
        ) from None
    try:
        with _quiet():
            model, report = AutoModel.from_pretrained(name, output_loading_info=True)
            processor = AutoImageProcessor.from_pretrained(name)
    except (OSError, ValueError, KeyError, ImportError) as error:
        reason = str(error).strip().splitlines()[0]
        raise EncoderError(
            f"encoder={name}: neither a file of weights nor a Hugging Face vision model: {reason}"
        ) from None
    # Models of images and texts hold the one of images under this name.
    inside = "vision_model" if hasattr(model, "vision_model") else ""
    missing = set(report["missing_keys"])
    model = getattr(model, inside) if inside else model
    used = {key: value for key, value in model.state_dict().items() if f"{inside}.{key}".lstrip(".") not in missing}
    random = sorted(key for key in model.state_dict() if key not in used and not key.startswith("pooler."))
    if random:
        raise EncoderError(f"encoder={name}: '{random[0]}' is missing in its weights, which would be random there")
    model = model.to(device).eval().requires_grad_(False)

    @torch.no_grad()
    def forward(views: Tensor) -> Tensor:
        images = processor(list(views.cpu().numpy()), return_tensors="pt", input_data_format="channels_last")
        hidden = model(pixel_values=images["pixel_values"].to(device)).last_hidden_state
        return hidden.flatten(2).mean(2) if hidden.ndim == 4 else hidden.mean(1)

    settings = {key: value for key, value in processor.to_dict().items() if key in RESIZING | SCALING}
    encoder = ViewEncoder(
        forward,
        {
            "extractor": f"{type(model).__name__} of transformers, mean of the last hidden state",
            "preprocessing": json.dumps(settings, sort_keys=True, default=dict),
            "weights": weights_hash(used),
        },
    )
    _try(encoder, name)
    return encoder


def _try(encoder: ViewEncoder, name: str) -> None:
    """Encode one grey image, so that a model of something else is found out before the work begins."""
    try:
        features = encoder(torch.full((1, 300, 400, 3), 128, dtype=torch.uint8))
    except (AttributeError, KeyError, RuntimeError, TypeError, ValueError) as error:
        reason = f"{type(error).__name__}: {error}".splitlines()[0]
        raise EncoderError(f"encoder={name}: is no backbone that gives a hidden state of images ({reason})") from None
    if features.ndim != 2:
        raise EncoderError(f"encoder={name}: gives {list(features.shape)} for one image; expected [1, D]")


@contextmanager
def _quiet() -> Iterator[None]:
    """Within this context transformers does not draw bars, nor list weights that are not used here."""
    from transformers.utils import logging as hf_logging

    log: Any = logging.getLogger("transformers")
    level, bars = log.level, hf_logging.is_progress_bar_enabled()
    log.setLevel(logging.ERROR)
    hf_logging.disable_progress_bar()
    try:
        yield
    finally:
        log.setLevel(level)
        if bars:
            hf_logging.enable_progress_bar()
