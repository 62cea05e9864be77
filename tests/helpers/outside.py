"""An encoder, heads and a loss as a user of the package writes them."""

import torch
from tensordict import TensorDict
from torch import nn

from dirl.models import ActorCriticHeads


class Product(nn.Module):
    """An encoder that can embed each distinct observation once: it has `embed` and `fuse`."""

    def __init__(self, num_features: int, width: int = 32, num_views: int = 4):
        super().__init__()
        self.layer = nn.Linear(num_views * num_features, width)
        self.sharp = nn.Parameter(torch.tensor(1.0))

    def embed(self, observation):
        return torch.tanh(self.sharp * self.layer(observation.flatten(-2)))

    def fuse(self, embedding, goal_embedding):
        return torch.cat([embedding, embedding * goal_embedding], -1)

    def forward(self, observation, goal_observation):
        return self.fuse(self.embed(observation), self.embed(goal_observation))


class DeepHeads(ActorCriticHeads):
    """Heads with a hidden layer more."""

    def __init__(self, scenes, in_features: int, num_actions: int, width: int = 32):
        super().__init__(scenes, in_features, num_actions, width)
        for name, layers in self.trunk.scenes.items():
            self.trunk.scenes[name] = nn.Sequential(*layers, nn.Linear(width, width), nn.Tanh())


class Confidence(nn.Module):
    """A loss on the policy's largest logit, reduced as ``reduction`` says."""

    def __init__(self, actor, reduction: str = "mean"):
        super().__init__()
        self.actor, self.reduction, self.in_keys = actor, reduction, list(actor.in_keys)

    def forward(self, batch):
        largest = self.actor.get_dist(batch.select(*self.in_keys)).logits.amax(-1)
        return TensorDict({"loss_confidence": largest if self.reduction == "none" else largest.mean()})
