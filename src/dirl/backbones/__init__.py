"""Frozen image encoders, which turn views into features."""

from dirl.backbones.registry import EncoderError, ViewEncoder, encode_scene, encode_views, load_encoder
from dirl.backbones.resnet import ResNet50, encode, load_backbone, preprocess

__all__ = [
    "EncoderError",
    "ResNet50",
    "ViewEncoder",
    "encode",
    "encode_scene",
    "encode_views",
    "load_backbone",
    "load_encoder",
    "preprocess",
]
