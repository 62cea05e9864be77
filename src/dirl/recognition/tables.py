"""A recogniser's scores in a world, computed once and looked up: the fast form of `Recogniser.scores`."""

import torch
from torch import Tensor

from dirl.recognition.recogniser import Recogniser, in_blocks
from dirl.scenes import World


class VisitScores:
    """The scores between every two visits of each scene of a world.

    A visit is named by its first view id, ``look * N + state``: the other three follow from it.

    Args:
        recogniser: compares them.
        world: N states in L looks each.
        match: ``views``, all four of them, or ``front``, the one ahead.
    """

    def __init__(self, recogniser: Recogniser, world: World, match: str = "views") -> None:
        blocks, row, column, size = [], [], [], 0
        for index in range(len(world.scenes)):
            visits = described_visits(recogniser, world, index)
            blocks.append(in_blocks(recogniser, visits, matched(visits, match)).T.flatten())
            column.append(torch.arange(len(visits), device=world.device))
            row.append(size + len(visits) * column[-1])
            size += len(visits) ** 2
        order = torch.cat([world.pictures(index) for index in range(len(world.scenes))]).argsort()
        self.table = torch.cat(blocks)
        self.row, self.column = torch.cat(row)[order], torch.cat(column)[order]

    def __call__(self, reference: Tensor, seen: Tensor) -> Tensor:
        """The scores of visits by their first view ids in one scene, int64 ``[...]`` each, broadcast; float32."""
        return self.table[self.row[reference] + self.column[seen]]


def described_visits(recogniser: Recogniser, world: World, index: int) -> Tensor:
    """The described views of the visits of one scene, float32 ``[M, 4, F]``, in the order of `World.pictures`."""
    pictures = world.pictures(index)
    patches = None if world.patches is None or not recogniser.reads_patches else world.patches[pictures]
    features, default = world.features[pictures], len(world.scenes[index])
    own = recogniser.fit(features[:default], None if patches is None else patches[:default])
    views = own.describe(features, patches)
    states, offset = len(world.scenes[index]), world.offsets[index]
    local = world.surrounding[offset : offset + states] - offset
    return views[torch.cat([local + look * states for look in range(world.looks)])]


def matched(visits: Tensor, match: str) -> Tensor:
    """The views of references that are compared: all, or with ``front`` the one ahead, ``[M, 1, F]``."""
    return visits[:, :1] if match == "front" else visits
