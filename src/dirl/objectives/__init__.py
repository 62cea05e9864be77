"""Losses, advantages and optimisers."""

from dirl.objectives.imitation import ImitationLoss, OptimalActionsLoss
from dirl.objectives.optim import TFRMSprop, clip_each
from dirl.objectives.reinforcement import bootstrap, make_advantages

__all__ = ["ImitationLoss", "OptimalActionsLoss", "TFRMSprop", "bootstrap", "clip_each", "make_advantages"]
