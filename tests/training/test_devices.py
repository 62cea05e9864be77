"""Training and evaluation on another device than the CPU."""

import pytest
import torch
from commands import TINY, room_file
from elsewhere import DEVICE, Elsewhere, device_elsewhere
from parts import make_parts, train_in

from dirl.scenes import World

SMALL = [
    *TINY,
    "imitation.max_steps=4",
    "reinforcement.frames_per_scene=30",
    "evaluation.starts=sampled",
    "evaluation.episodes_per_goal=2",
    "evaluation.goals=2",
    "evaluation.times=1",
]


@pytest.fixture
def elsewhere(monkeypatch):
    """``device=cuda`` is `DEVICE`."""
    to = World.to
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(World, "to", lambda world, device: to(world, DEVICE if str(device) == "cuda" else device))
    with device_elsewhere(monkeypatch):
        yield


def test_a_tensor_of_another_device_is_refused_beside_one_of_the_cpu(elsewhere):
    here, there = torch.ones(3), torch.ones(3, device=DEVICE)
    assert (there + there).device == DEVICE
    for mixed in (lambda: here + there, lambda: there @ here, lambda: torch.where(there > 0, here, here)):
        with pytest.raises(RuntimeError, match="same device"):
            mixed()
    assert (there.cpu() + here).tolist() == [2, 2, 2]


@pytest.mark.parametrize("options", [["system=td_drl"], ["system=any_goal", "objective=a2c"]])
def test_a_training_on_another_device_learns_the_same(options, tmp_path, elsewhere):
    room = room_file(tmp_path, patches=True)
    trained = []
    for device in ("cpu", "cuda"):
        parts = make_parts(f"scene={room}", *SMALL, f"device={device}", *options)
        train_in(tmp_path / device, parts)
        trained.append(parts.policy.state_dict())
    on_cpu, there = trained
    assert all(isinstance(value, Elsewhere) for value in there.values())
    assert all(torch.equal(value.cpu(), on_cpu[name]) for name, value in there.items())
