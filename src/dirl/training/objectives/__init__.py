"""Losses, advantages and optimisers."""

from dirl.training.objectives.imitation import ImitationLoss, OptimalActionsLoss
from dirl.training.objectives.optim import TFRMSprop, clip_each
from dirl.training.objectives.reinforcement import bootstrap, make_advantages

__all__ = ["ImitationLoss", "OptimalActionsLoss", "TFRMSprop", "bootstrap", "clip_each", "make_advantages"]
