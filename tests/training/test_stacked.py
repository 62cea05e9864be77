"""Several trainings as one program."""

import pytest
import torch
from commands import TINY, room_file
from parts import make_parts, train_state
from pretend_graph import pretend
from train import learn

from dirl.training.stacked import Stack

VARIED = [
    ("seed=1",),
    ("seed=2", "imitation.fraction=0.4", "optimiser.lr=0.003", "reward.goal=5.0"),
    ("seed=3", "reinforcement.gamma=0.9", "reinforcement.entropy_coef=0.1", "imitation.bc_coef=1.0"),
]


def make_states(room, options=VARIED):
    """The parts and the states of runs, with the generators that they have in a stack."""
    every = [make_parts(f"scene={room}", *TINY, *own) for own in options]
    states = [train_state(parts) for parts in every]
    for parts, state in zip(every, states, strict=True):
        state.generator = torch.Generator().manual_seed(parts.config.seed)
    return every, states


def make_stack(room, options=VARIED):
    every, states = make_states(room, options)
    configs, demos = [parts.config for parts in every], [parts.demos for parts in every]
    return Stack(configs, states, demos, every[0].world, every[0].observation)


class Updates:
    """So many updates, of a stack or of one run."""

    def __init__(self, count, state):
        self.count, self.reports, self.state = count, [], state

    @property
    def goes_on(self):
        return len(self.reports) < self.count

    def record(self, report):
        self.reports.append(report)
        self.state.left.fill_(1 - len(self.reports) / 100)


def learned(stack, updates):
    loop = Updates(updates, stack)
    learn(stack.config, stack, loop, stack.prepared)
    return loop.reports


def test_each_run_of_a_stack_learns_what_it_learns_alone(tmp_path):
    room = room_file(tmp_path)
    stack = make_stack(room)
    reports = learned(stack, 3)
    every, states = make_states(room)
    for number, (parts, state) in enumerate(zip(every, states, strict=True)):
        torch.manual_seed(parts.config.seed)
        loop = Updates(3, state)
        learn(parts.config, state, loop)
        for (alone,), together in zip(loop.reports, reports, strict=True):
            own = together[number]
            assert (alone.goal_index, alone.steps, alone.frames) == (own.goal_index, own.steps, own.frames)
            assert own.values == pytest.approx(alone.values, abs=1e-4)
        weights = dict(stack.members[number].policy.named_parameters())
        for name, value in state.policy.named_parameters():
            torch.testing.assert_close(weights[name], value, atol=1e-5, rtol=0)


def test_a_captured_update_computes_what_it_does_without_a_graph(tmp_path, monkeypatch, capsys):
    room = room_file(tmp_path)
    eager = make_stack(room)
    reports = learned(eager, 8)
    graphs = pretend(monkeypatch)
    captured = make_stack(room)
    assert learned(captured, 8) == reports
    assert [len(graph.calls) > 100 for graph in graphs] == [True]
    assert capsys.readouterr().err == ""
    for one, other in zip(eager.parameters, captured.parameters, strict=True):
        assert torch.equal(one, other)
