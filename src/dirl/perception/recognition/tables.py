"""A recogniser's scores in a world, computed once and looked up: the fast form of `Recogniser.scores`."""

import torch
from torch import Tensor

from dirl.config.components import tried
from dirl.perception.recognition.recogniser import ComparesPanoramas, Recogniser, in_blocks, panorama_odds
from dirl.scenes.world import World


class VisitScores:
    """The scores between every two visits of each scene of a world.

    A visit is named by its first view id, ``look * N + state``: the other three follow from it. All scores of
    a reference are computed when it is first asked for.

    Args:
        recogniser: compares them.
        world: N states in L looks each.
        match: ``views``, all four of them, or ``front``, the one ahead.
    """

    @torch.no_grad()
    def __init__(self, recogniser: Recogniser, world: World, match: str = "views") -> None:
        self.recogniser, self.match = recogniser, match
        self.visits = [described_visits(recogniser, world, index) for index in range(len(world.scenes))]
        sizes = torch.tensor([len(visits) for visits in self.visits], device=world.device)
        order = torch.cat([world.pictures(index) for index in range(len(world.scenes))]).argsort()
        self.scene = torch.arange(len(sizes), device=world.device).repeat_interleave(sizes)[order]
        self.column = torch.cat([torch.arange(size, device=world.device) for size in sizes.tolist()])[order]
        self.row = (sizes**2).cumsum(0)[self.scene] - sizes[self.scene] * (sizes[self.scene] - self.column)
        self.table = torch.empty(int((sizes**2).sum()), device=world.device)
        self.known = torch.zeros(len(order), dtype=torch.bool, device=world.device)
        self.whole: Tensor | None = None
        """What panoramas are compared by, of each view id, float32 ``[M, W]``; None = four views at a time are."""
        if isinstance(recogniser, ComparesPanoramas):
            self.whole = torch.cat([recogniser.whole(visits[:, 0]) for visits in self.visits])[order]

    def __call__(self, reference: Tensor, seen: Tensor) -> Tensor:
        """The scores of visits by their first view ids in one scene, int64 ``[...]`` each, broadcast; float32."""
        asked = reference[~self.known[reference]]
        if len(asked):
            self._compute(asked.unique())
        return self.table[self.row[reference] + self.column[seen]]

    def of_visits(self, seen: Tensor, visit: Tensor) -> Tensor:
        """How much visits ``[B, K]`` look like earlier ones, ``[B, T, K]``, facing each of their views; all view ids.

        A node faces the view that was ahead or aside, by whose view id it is named. Of a panorama each four views, 90
        degrees apart, are compared, and the mean is taken, unless the recogniser `ComparesPanoramas`.
        """
        rings = visit.shape[1] // self.visits[0].shape[1]
        if rings > 1 and self.whole is not None:
            return panorama_odds(self.whole[seen], self.whole[visit])
        scores = [self(seen.roll(-ring, 2), visit[:, None, ring, None]) for ring in range(rings)]
        return torch.stack(scores).mean(0) if rings > 1 else scores[0]

    def of_goal(self, goal: Tensor, visits: Tensor, place: Tensor) -> Tensor:
        """Log odds that panoramas see goals, by their view ids; see `panorama_odds`."""
        assert self.whole is not None
        return panorama_odds(self.whole[visits], self.whole[goal], self.whole[place])

    @torch.no_grad()
    def _compute(self, reference: Tensor) -> None:
        """Fill the rows of references, int64 ``[A]``."""
        for index in self.scene[reference].unique().tolist():
            visits, rows = self.visits[index], reference[self.scene[reference] == index]
            found = in_blocks(self.recogniser, visits, matched(visits[self.column[rows]], self.match)).T
            self.table[self.row[rows][:, None] + torch.arange(len(visits), device=rows.device)] = found
        self.known[reference] = True


def described_visits(recogniser: Recogniser, world: World, index: int) -> Tensor:
    """The described views of the visits of one scene, float32 ``[M, 4, F]``, in the order of `World.pictures`."""
    pictures, states, offset = world.pictures(index), len(world.scenes[index]), world.offsets[index]
    patches = None if world.patches is None or not recogniser.reads_patches else world.patches[pictures]
    features = world.features[pictures]
    with tried("recogniser", recogniser):
        own = recogniser.fit(features[:states], None if patches is None else patches[:states])
        views = own.describe(features, patches)
        if views.ndim != 2 or len(views) != len(features):
            raise ValueError(f"describe gave {list(views.shape)} for {len(features)} views; expected [N, F]")
        visit = views[:4].unsqueeze(0)
        scores = own.scores(visit.repeat(2, 1, 1), visit.repeat(3, 1, 1))
        if scores.shape != (2, 3):
            raise ValueError(f"scores gave {list(scores.shape)} for 2 visits and 3 references; expected [2, 3]")
    local = world.surrounding[offset : offset + states] - offset
    return views[torch.cat([local + look * states for look in range(world.looks)])]


def matched(visits: Tensor, match: str) -> Tensor:
    """The views of references that are compared: all, or with ``front`` the one ahead, ``[M, 1, F]``."""
    return visits[:, :1] if match == "front" else visits
