import math

import torch

from dirl.agent.agent import Planning
from dirl.agent.cameras import compare
from dirl.models import PlanningMemory
from dirl.perception.recognition.recogniser import NCC


class Seen:
    """A visit whose policy answers always the same."""

    def __init__(self, visit):
        self.visit = visit

    def alike(self, seen):
        return compare(NCC(), seen, self.visit)

    def facing(self, chosen):
        return torch.arange(16.0).view(1, 4, 4)

    def goal_around(self, chosen):
        return torch.zeros(1, 4, dtype=torch.bool)


def test_what_looks_like_a_later_look_of_a_place_but_not_like_the_first_is_another_place():
    """Looks 12 degrees apart match above 0.95, those 24 degrees apart do not; places are known by their first look."""
    first, other = torch.linalg.qr(torch.randn(4 * 64, 2, generator=torch.Generator().manual_seed(0)))[0].T
    agent = Planning(PlanningMemory(), torch.tensor([4]))
    for angle, node in ((0, 0), (12, 0), (24, 8)):
        look = math.cos(math.radians(angle)) * first + math.sin(math.radians(angle)) * other
        action, planned = agent.act(Seen(look.view(1, 4, 64)))
        assert agent.past.here.tolist() == [node]
        assert planned.isfinite().all()
        agent.action = torch.zeros_like(action)
