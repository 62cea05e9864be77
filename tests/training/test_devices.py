"""Training and evaluation on another device than the CPU."""

import pytest
import torch
from commands import TINY, room_file, train_config
from elsewhere import DEVICE, Elsewhere, device_elsewhere
from parts import make_parts, train_in

from dirl.agent.mapping import ImageGraph
from dirl.config.schemas import Device
from dirl.evaluation.protocol import action_values
from dirl.perception.recognition import Learned
from dirl.perception.recognition.build import build_recogniser
from dirl.runs.checkpoints import load_checkpoint
from dirl.scenes import World
from dirl.training.job import sum_in_order
from dirl.training.load import load_trained

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


def test_a_policy_trained_on_the_cpu_walks_alike_on_another_device(tmp_path, elsewhere):
    train_in(tmp_path / "run", make_parts(f"scene={room_file(tmp_path)}", *SMALL))
    found = []
    for device in ("cpu", "cuda"):
        _, policy, protocol = load_trained(load_checkpoint(tmp_path / "run"), "run", {"device": device})
        episodes = protocol.run(policy)
        found.append(
            [*action_values(policy, protocol.world, protocol.observation, 0), episodes.steps, episodes.success]
        )
    assert all(isinstance(one, Elsewhere) for one in found[1])
    assert all(torch.equal(one, there.cpu()) for one, there in zip(*found, strict=True))


def test_a_recogniser_is_where_the_world_is_and_that_of_a_map_on_the_cpu(elsewhere):
    there = build_recogniser(train_config("recogniser=learned"), DEVICE)
    assert isinstance(there, Learned)
    assert all(isinstance(value, Elsewhere) for value in there.state_dict().values())
    kept = ImageGraph(recogniser=there).recogniser
    assert {value.device.type for value in kept.state_dict().values()} == {"cpu"}
    assert all(isinstance(value, Elsewhere) for value in there.state_dict().values())
    assert ImageGraph(recogniser=kept).recogniser is kept


def test_on_a_gpu_alone_kernels_are_chosen_that_add_in_a_fixed_order(monkeypatch):
    monkeypatch.setenv("CUBLAS_WORKSPACE_CONFIG", ":16:8")  # what the user chose stays
    try:
        sum_in_order(Device.cpu)
        assert not torch.are_deterministic_algorithms_enabled()
        sum_in_order(Device.cuda)
        assert torch.are_deterministic_algorithms_enabled()
        assert torch.is_deterministic_algorithms_warn_only_enabled()
    finally:
        torch.use_deterministic_algorithms(False)
