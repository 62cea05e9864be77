"""Vision backbones of Hugging Face transformers as encoders."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import torch
from torch import Tensor

from dirl.perception.backbones.encoder import EncoderError, ViewEncoder, weights_hash

# Of an image processor's many settings, those that change what a model sees.
SETTINGS = {"do_resize", "size", "resample", "crop_pct", "do_center_crop", "crop_size"}
SETTINGS |= {"do_rescale", "rescale_factor", "do_normalize", "image_mean", "image_std"}


def huggingface_encoder(name: str, device: str | torch.device) -> ViewEncoder:
    """The mean over tokens or pixels of a model's last hidden state; every kind of backbone has one.

    (Poolers are not used: a checkpoint that was trained for classification often lacks the pooler's weights.)

    Raises:
        EncoderError: there is no such model, it does not take images, or transformers is not installed.
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

    forward = partial(_mean_state, model, processor, device)
    settings = {key: value for key, value in processor.to_dict().items() if key in SETTINGS}
    # One grey image is tried, so that an unsuitable model is detected before the work begins.
    try:
        features = forward(torch.full((1, 300, 400, 3), 128, dtype=torch.uint8))
    except (AttributeError, KeyError, RuntimeError, TypeError, ValueError) as error:
        reason = f"{type(error).__name__}: {error}".splitlines()[0]
        raise EncoderError(f"encoder={name}: is no backbone that gives a hidden state of images ({reason})") from None
    if features.ndim != 2:
        raise EncoderError(f"encoder={name}: gives {list(features.shape)} for one image; expected [1, D]")
    attributes = {
        "extractor": f"{type(model).__name__} of transformers, mean of the last hidden state",
        "preprocessing": json.dumps(settings, sort_keys=True, default=dict),
        "weights": weights_hash(used),
    }
    return ViewEncoder(forward, attributes)


@torch.no_grad()
def _mean_state(model: Any, processor: Any, device: str | torch.device, views: Tensor) -> Tensor:
    images = processor(list(views.cpu().numpy()), return_tensors="pt", input_data_format="channels_last")
    hidden = model(pixel_values=images["pixel_values"].to(device)).last_hidden_state
    return hidden.flatten(2).mean(2) if hidden.ndim == 4 else hidden.mean(1)


@contextmanager
def _quiet() -> Iterator[None]:
    """Within this context transformers shows no progress bars and does not list unused weights."""
    from transformers.utils import logging

    level, bars = logging.get_verbosity(), logging.is_progress_bar_enabled()
    logging.set_verbosity_error()
    logging.disable_progress_bar()
    try:
        yield
    finally:
        logging.set_verbosity(level)
        if bars:
            logging.enable_progress_bar()
