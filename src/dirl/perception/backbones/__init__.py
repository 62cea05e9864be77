"""Frozen image encoders, which turn views into features."""

from dirl.perception.backbones.encoder import EncoderError, ViewEncoder
from dirl.perception.backbones.registry import Encoded, encode_all, load_encoder
from dirl.perception.backbones.resnet import ResNet50, load_backbone, preprocess

__all__ = [
    "Encoded",
    "EncoderError",
    "ResNet50",
    "ViewEncoder",
    "encode_all",
    "load_backbone",
    "load_encoder",
    "preprocess",
]
