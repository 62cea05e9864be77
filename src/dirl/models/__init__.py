"""The network."""

from dirl.models.actor_critic import Network, actor_critic, count_parameters, make_network
from dirl.models.features import FeatureTable, feature_statistics
from dirl.models.siamese import SiameseEncoder

__all__ = [
    "FeatureTable",
    "Network",
    "SiameseEncoder",
    "actor_critic",
    "count_parameters",
    "feature_statistics",
    "make_network",
]
