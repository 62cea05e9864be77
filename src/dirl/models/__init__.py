"""The network, and knowing the goal by sight."""

from dirl.models.encoders import EncoderError, ViewEncoder, encode_scene, encode_views, load_encoder
from dirl.models.features import FeatureTable, feature_statistics
from dirl.models.matching import TemplateStop, ncc, stop_errors, template_vectors
from dirl.models.network import Network, actor_critic, count_parameters, make_network
from dirl.models.resnet import ResNet50, encode, load_backbone, preprocess
from dirl.models.siamese import SiameseEncoder

__all__ = [
    "EncoderError",
    "FeatureTable",
    "Network",
    "ResNet50",
    "SiameseEncoder",
    "TemplateStop",
    "ViewEncoder",
    "actor_critic",
    "count_parameters",
    "encode",
    "encode_scene",
    "encode_views",
    "feature_statistics",
    "load_backbone",
    "load_encoder",
    "make_network",
    "ncc",
    "preprocess",
    "stop_errors",
    "template_vectors",
]
