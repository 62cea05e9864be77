"""The outputs of the frozen backbone, as a table with one row for each state."""

import math
from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import Tensor, nn

from dirl.perception.backbones.principal import principal_components

ROWS_AT_ONCE = 20_000

SAMPLED = 30_000
"""States, evenly spread, that principal components are computed of where there are more."""

DEPENDENT = 1e-9
"""An axis with less than this fraction of the first one's variance holds nothing but rounding errors."""

NOISE_ROWS = 1024
"""Of noise that more states share in an update; to draw normal numbers takes longer than anything else of a reading."""


class FeatureTable(nn.Module):
    """Features of N states as the network reads them: standardised or whitened, followed by patches if there are any.

    The table itself is data, not a parameter, and stays out of the state_dict. ``mean``, ``std`` and ``axes`` are kept
    there, because the weights depend on them. State N stands for a view that is not known, as three of
    the four of a goal that is given by one photo; its features are zeros, the mean of all views.

    Args:
        features: pooled ones of every state, float32 ``[N, D]``.
        mean: subtracted from the pooled features, float32 ``[D]``; zero if left out.
        std: divided by, float32 ``[D]``; one if left out.
        axes: what they are multiplied by, float32 ``[D, components]``, see `dirl.perception.backbones.principal`;
            or None.
        patches: which follow them, floats ``[N, cells, channels]``; or None.
        room: rows after state N, for views that are encoded when they are seen, see `write`.
    """

    def __init__(
        self,
        features: Tensor,
        mean: Tensor | None = None,
        std: Tensor | None = None,
        axes: Tensor | None = None,
        patches: Tensor | None = None,
        room: int = 0,
    ) -> None:
        super().__init__()
        width, device, self.room = features.shape[1], features.device, room
        self._noise: Tensor | None = None
        self.register_buffer("mean", torch.zeros(width, device=device) if mean is None else mean.to(device))
        self.register_buffer("std", torch.ones(width, device=device) if std is None else std.to(device))
        self.register_buffer("axes", None if axes is None else axes.to(device))
        self.register_buffer("features", features, persistent=False)
        self.register_buffer("patches", patches, persistent=False)
        self.register_buffer("table", None, persistent=False)
        self.refresh()
        self.width = self.table.shape[1]
        """The number of features of a view as the network reads it."""
        self.register_load_state_dict_post_hook(FeatureTable.refresh)  # can be pickled with the module

    mean: Tensor
    std: Tensor
    axes: Tensor | None
    features: Tensor
    patches: Tensor | None
    table: Tensor
    """float32 ``[N + 1 + room, width]``."""

    def refresh(self, _: object = None) -> None:
        """Compute the table anew, with the mean, deviation and axes as they are now.

        Block by block: the table of hundreds of rooms takes gigabytes, and is held only once.
        """
        states, pooled = len(self.features), len(self.mean) if self.axes is None else self.axes.shape[1]
        patches = None if self.patches is None else self.patches.flatten(1)
        width = pooled + (0 if patches is None else patches.shape[1])
        table = torch.zeros((states + 1 + self.room, width), device=self.features.device)
        for first in range(0, states, ROWS_AT_ONCE):
            rows = slice(first, min(first + ROWS_AT_ONCE, states))
            table[rows, :pooled] = self.standardise(self.features[rows])
            if patches is not None:
                table[rows, pooled:] = patches[rows]
        self.table = table

    def __len__(self) -> int:
        """Return the number of states, N."""
        return len(self.features)

    @property
    def inputs(self) -> int:
        """The number of features of a view as the backbone gives it, D and those of its patches."""
        return self.features.shape[1] + (0 if self.patches is None else math.prod(self.patches.shape[1:]))

    @property
    def known(self) -> Tensor:
        """The rows of the N states."""
        return self.table[: len(self)]

    def write(self, rows: Tensor, features: Tensor) -> None:
        """Put backbone outputs ``[R, D + patches]`` into rows of the room, int64 ``[R]``, from N + 1 on."""
        self.table[rows] = self.standardise(features)

    def standardise(self, features: Tensor) -> Tensor:
        """Return backbone outputs ``[..., D + patches]`` as the network reads them, float32 ``[..., width]``."""
        pooled = features[..., : len(self.mean)]
        pooled = (pooled - self.mean) / self.std
        if self.axes is not None:
            pooled = pooled @ self.axes
        patches = features[..., len(self.mean) :]
        return torch.cat([pooled, patches], -1) if patches.shape[-1] else pooled

    def forward(self, states: Tensor) -> Tensor:
        """Return the features of states, int64 ``[...]`` to float32 ``[..., width]``."""
        rows = self.table[states]
        if self._noise is not None:
            rows = rows + self._noise[torch.where(states < len(self), states % NOISE_ROWS, NOISE_ROWS)]
        return rows

    @contextmanager
    def noisy(self, deviation: float) -> Iterator[None]:
        """Add Gaussian noise, sampled when this context begins, to known views within it; see `NOISE_ROWS`."""
        self._noise = deviation * torch.randn_like(self.table[:1].expand(NOISE_ROWS + 1, -1).contiguous())
        self._noise[-1] = 0
        try:
            yield
        finally:
            self._noise = None


class ObservationTable(FeatureTable):
    """All observations of a world, rotated once into the principal axes of their span.

    The N states of a world give N observations of 4 x D features, if all that is seen depends on the state alone. They
    span at most N dimensions. In coordinates of these a linear layer computes exactly what it does on features, but
    has at most N columns instead of 4 x D: fewer operations by far. With views of the past any four states can be seen
    together: then each view has coordinates of its own.

    Weights on coordinates are as good as weights on features, see `widen`: a checkpoint holds the latter, so that they
    serve in other worlds as well.

    Args:
        table: the features of its states.
        surrounding: the four states seen from each state, int64 ``[N, 4]``, if they are all that is ever seen there;
            None if any four states can be seen. View id N is a view that is not shown.
        views: how many an observation has.
    """

    def __init__(self, table: FeatureTable, surrounding: Tensor | None, views: int) -> None:
        super().__init__(table.features, table.mean, table.std, table.axes)
        self.register_buffer("surrounding", surrounding, persistent=False)
        self.slots = views if surrounding is None else 1
        # The singular value decomposition of the observations X = U L V', by way of X X' = U L^2 U'. Always by the CPU:
        # four views seen from four headings give pairs of equally long axes, which every device would turn otherwise.
        rows = self.table.cpu().double()
        products = rows @ rows.T
        if surrounding is None:
            products = products[:-1, :-1]
        else:
            products = torch.stack([products[views][:, views] for views in surrounding.cpu().unbind(1)]).sum(0)
        variance, left = torch.linalg.eigh(products)
        kept = variance > DEPENDENT * variance[-1]
        # In the state_dict, because another machine finds other axes where two are equally long.
        self.register_buffer("coordinates", (left[:, kept] * variance[kept].sqrt()).to(self.features))
        self.width = self.coordinates.shape[1]
        """The number of coordinates in a slot."""

    surrounding: Tensor | None
    coordinates: Tensor
    """X V = U L: of each observation, or of each view if any four can be seen, float32 ``[N, R]``."""

    def forward(self, view_ids: Tensor) -> Tensor:
        """Return the coordinates of observations, int64 ``[..., 4]`` to float32 ``[..., slots, R]``."""
        return self.coordinates[view_ids[..., : self.slots]]

    def narrow(self, weight: Tensor) -> Tensor:
        """Return a layer's weight on features, float32 ``[F, 4 * D]``, as weight on coordinates, ``[F, slots * R]``."""
        return (weight.unflatten(1, (self.slots, -1)) @ self._axes()).flatten(1)

    def widen(self, weight: Tensor) -> Tensor:
        """Return a weight on coordinates, float32 ``[F, slots * R]``, as weight on features, ``[F, 4 * D]``.

        It does the same to every observation of the world, and nothing to what the world never shows.
        """
        return (weight.unflatten(1, (self.slots, -1)) @ self._axes().T).flatten(1)

    def _axes(self) -> Tensor:
        """Return the axes V, as columns, float32 ``[4 * D, R]`` or ``[D, R]``."""
        rows = self.known if self.surrounding is None else self.table[self.surrounding].flatten(-2)
        return rows.T @ (self.coordinates / self.coordinates.square().sum(0))


def feature_statistics(features: Tensor) -> tuple[Tensor, Tensor]:
    """Return mean and standard deviation of each feature over the states, float32 ``[D]`` each.

    A feature that never changes gets the deviation one, so that it becomes zero. Both are added up by the CPU, for all
    devices alike.
    """
    features = features.cpu()
    mean, std = features.mean(0), features.std(0)
    return mean, torch.where(std > 1e-6, std, torch.ones_like(std))


def whitening(features: Tensor, count: int) -> tuple[Tensor, Tensor, Tensor]:
    """Return mean, standard deviation (ones) and axes that whiten features to principal components of unit variance.

    Of more than `SAMPLED` states evenly spread ones are used: in double precision all of 300,000 take 15 GB.
    """
    mean, axes = principal_components(features[:: math.ceil(len(features) / SAMPLED)], count)
    return mean, torch.ones_like(mean), axes
