"""The network, and knowing the goal by sight."""

from dirl.models.features import FeatureTable, feature_statistics
from dirl.models.matching import TemplateStop, ncc, stop_errors
from dirl.models.network import Network, actor_critic, count_parameters, make_network
from dirl.models.siamese import SiameseEncoder

__all__ = [
    "FeatureTable",
    "Network",
    "SiameseEncoder",
    "TemplateStop",
    "actor_critic",
    "count_parameters",
    "feature_statistics",
    "make_network",
    "ncc",
    "stop_errors",
]
