import math

import torch

from dirl.agent.recall import CameraSight, Planning
from dirl.models import PlanningMemory
from dirl.recognition.recogniser import NCC


def test_what_looks_like_a_later_look_of_a_place_but_not_like_the_first_is_another_place():
    """Looks 12 degrees apart match above 0.95, those 24 degrees apart do not; places are known by their first look."""
    first, other = torch.linalg.qr(torch.randn(4 * 64, 2, generator=torch.Generator().manual_seed(0)))[0].T
    recall, logits = Planning(PlanningMemory(), CameraSight(NCC()), torch.tensor([4])), torch.arange(16.0).view(1, 4, 4)
    around = logits, torch.zeros(1, 4, dtype=torch.bool)
    for angle, node in ((0, 0), (12, 0), (24, 8)):
        look = math.cos(math.radians(angle)) * first + math.sin(math.radians(angle)) * other
        planned = recall.adjust(look.view(1, 4, 64), lambda: logits[:, 0], lambda _: around)
        assert recall.walked.here.tolist() == [node]
        assert planned.isfinite().all()
        recall.acted(torch.tensor([0]))
