"""The network: encoder, optional memory, and heads."""

from dirl.models.comparing import ComparingEncoder
from dirl.models.features import FeatureTable, ObservationTable, feature_statistics, whitening
from dirl.models.localising import LocalisingMemory
from dirl.models.planning import PlanningMemory, PlanState
from dirl.models.policy import (
    ActorCritic,
    ActorCriticHeads,
    KeyedModule,
    SiameseEncoder,
    caching,
    initial_state,
    noisy,
    plain_weights,
    recurrent_keys,
    state_primer,
)

__all__ = [
    "ActorCritic",
    "ActorCriticHeads",
    "ComparingEncoder",
    "FeatureTable",
    "KeyedModule",
    "LocalisingMemory",
    "ObservationTable",
    "PlanState",
    "PlanningMemory",
    "SiameseEncoder",
    "caching",
    "feature_statistics",
    "initial_state",
    "noisy",
    "plain_weights",
    "recurrent_keys",
    "state_primer",
    "whitening",
]
