"""Training and evaluation on another device than the CPU."""

import pytest
import torch
from commands import TINY, room_file
from elsewhere import DEVICE, Elsewhere, device_elsewhere
from parts import make_parts, train_in

from dirl.agent.decisions import answers
from dirl.config.schemas import Device
from dirl.models import FeatureTable, ObservationTable
from dirl.runs.checkpoints import load_checkpoint
from dirl.scenes import World
from dirl.training.build import load_trained
from dirl.training.job import prepare_device

SMALL = [*TINY, "imitation.max_steps=4", "reinforcement.frames_per_scene=30", "evaluation.starts=sampled"]
SMALL += ["evaluation.episodes_per_goal=2", "evaluation.goals=2", "evaluation.times=1"]


@pytest.fixture
def elsewhere(monkeypatch):
    """``device=cuda`` is `DEVICE`."""
    to = World.to
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(World, "to", lambda world, device: to(world, DEVICE if str(device) == "cuda" else device))
    with device_elsewhere(monkeypatch):
        yield


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


def test_the_axes_of_observations_are_found_by_the_cpu(monkeypatch, elsewhere):
    given, eigh = [], torch.linalg.eigh
    monkeypatch.setattr(torch.linalg, "eigh", lambda matrix: given.append(matrix) or eigh(matrix))
    features = torch.rand(6, 5).to(DEVICE)
    surrounding = torch.stack([torch.arange(6)] * 4, 1).to(DEVICE)
    for seen in (surrounding, None):
        assert isinstance(ObservationTable(FeatureTable(features), seen, 4).coordinates, Elsewhere)
    assert not any(isinstance(matrix, Elsewhere) for matrix in given)


def test_a_policy_trained_on_the_cpu_walks_alike_on_another_device(tmp_path, elsewhere):
    train_in(tmp_path / "run", make_parts(f"scene={room_file(tmp_path)}", *SMALL))
    found = []
    for device in ("cpu", "cuda"):
        _, policy, protocol = load_trained(load_checkpoint(tmp_path / "run"), "run", {"device": device})
        episodes = protocol.run(policy)
        found.append([*answers(policy, protocol.world, protocol.observation, 0), episodes.steps, episodes.success])
    assert all(isinstance(one, Elsewhere) for one in found[1])
    assert all(torch.equal(one, there.cpu()) for one, there in zip(*found, strict=True))


def test_on_a_gpu_alone_kernels_are_chosen_that_add_in_a_fixed_order(monkeypatch):
    chosen = []
    monkeypatch.setenv("CUBLAS_WORKSPACE_CONFIG", ":16:8")  # what the user chose stays
    monkeypatch.setattr(torch, "use_deterministic_algorithms", lambda on, *, warn_only: chosen.append((on, warn_only)))
    prepare_device(Device.cpu)
    assert not chosen
    prepare_device(Device.cuda)
    assert chosen == [(True, True)]
