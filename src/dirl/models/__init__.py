"""The network: encoder, memory, heads."""

from dirl.models.actor_critic import (
    ActorCritic,
    KeyedModule,
    caching,
    count_parameters,
    frozen,
    initial_state,
    plain_weights,
    recurrent_keys,
)
from dirl.models.features import FeatureTable, feature_statistics
from dirl.models.heads import ActorCriticHeads
from dirl.models.siamese import SiameseEncoder

__all__ = [
    "ActorCritic",
    "ActorCriticHeads",
    "FeatureTable",
    "KeyedModule",
    "SiameseEncoder",
    "caching",
    "count_parameters",
    "feature_statistics",
    "frozen",
    "initial_state",
    "plain_weights",
    "recurrent_keys",
]
