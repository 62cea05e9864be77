import torch

from dirl.models import EpisodicMemory


def walked(memory, *steps):
    """The trace of one agent: steps are (place, action, place after it)."""
    trace = memory.begin(1)
    for before, action, after in steps:
        one = torch.tensor([before]), torch.tensor([action]), torch.tensor([after])
        trace = memory.record(trace, *one, torch.tensor([before != after]))
    return trace


def penalties(memory, trace, place):
    return (-memory.adjust(torch.zeros(1, 4), trace, trace.place == place)[0]).tolist()


def test_what_was_done_at_a_place_and_what_undoes_it_is_counted():
    memory = EpisodicMemory(penalty=2.0, opposite=0.5, blocked=5.0)
    ahead, right, _left, back = range(4)
    trace = walked(memory, (0, ahead, 1), (1, right, 2), (2, back, 2), (2, right, 3), (0, ahead, 1))
    assert penalties(memory, trace, 0) == [4, 0, 0, 0]  # ahead, twice
    assert penalties(memory, trace, 1) == [0, 2, 0, 2]  # right; and back to 0, half of it twice
    assert penalties(memory, trace, 2) == [0, 2, 1, 10]  # right; left, half; back was blocked
    assert penalties(memory, trace, 3) == [0, 0, 1, 0]
    assert penalties(memory, trace, 4) == [0, 0, 0, 0]


def test_logits_are_lowered_agent_by_agent():
    memory, logits = EpisodicMemory(penalty=3.0, opposite=0.0), torch.arange(8.0).view(2, 4)
    trace = memory.record(memory.begin(2), *torch.tensor([[0, 5], [1, 2], [1, 6]]), torch.tensor([True, True]))
    adjusted = memory.adjust(logits, trace, torch.tensor([[True, False], [False, False]]))
    assert adjusted.tolist() == [[0, -2, 2, 3], [4, 5, 6, 7]]
    assert torch.equal(memory.adjust(logits, memory.begin(2), torch.empty(2, 0, dtype=torch.bool)), logits)


def test_some_agents_go_on():
    memory = EpisodicMemory()
    trace = memory.record(memory.begin(3), *torch.arange(9).view(3, 3) % 4, torch.tensor([True, True, False]))
    kept = trace.select(torch.tensor([True, False, True]))
    assert torch.equal(kept.place, trace.place[[0, 2]])
    assert torch.equal(kept.weight, trace.weight[[0, 2]])
