"""The frozen backbone, as the table of its outputs: what is known of a view without computing anything."""

import torch
from torch import Tensor, nn


class FeatureTable(nn.Module):
    """Features of states, standardised dimension by dimension.

    The table itself is data, not a parameter, and stays out of the state_dict; ``mean`` and ``std`` are kept there,
    because a network is worth nothing without them.

    Args:
        features: the backbone's output for every state, float32 ``[N, D]``.
        mean: subtracted, float32 ``[D]``; zero if left out.
        std: divided by, float32 ``[D]``; one if left out.
    """

    def __init__(self, features: Tensor, mean: Tensor | None = None, std: Tensor | None = None) -> None:
        super().__init__()
        width = features.shape[1]
        self.register_buffer("mean", torch.zeros(width) if mean is None else mean)
        self.register_buffer("std", torch.ones(width) if std is None else std)
        self.register_buffer("features", features, persistent=False)
        self.register_buffer("table", self.standardise(features), persistent=False)
        self.register_load_state_dict_post_hook(lambda table, _: table.refresh())

    mean: Tensor
    std: Tensor
    features: Tensor
    table: Tensor

    def refresh(self) -> None:
        """Standardise the features anew, with the mean and deviation as they are now."""
        self.table = self.standardise(self.features)

    def __len__(self) -> int:
        """The number of states, N."""
        return len(self.table)

    @property
    def width(self) -> int:
        """The number of features of a view, D."""
        return self.table.shape[1]

    def standardise(self, features: Tensor) -> Tensor:
        """Raw features of the backbone as the network wants them, float32 ``[..., D]``."""
        return (features - self.mean) / self.std

    def forward(self, states: Tensor) -> Tensor:
        """The standardised features of states, int64 ``[...]`` to float32 ``[..., D]``."""
        return self.table[states]


def feature_statistics(features: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and standard deviation of each feature over the states, float32 ``[D]`` each.

    A feature that never changes gets the deviation one, so that it becomes zero.
    """
    mean, std = features.mean(0), features.std(0)
    return mean, torch.where(std > 1e-6, std, torch.ones_like(std))
