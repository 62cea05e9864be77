"""Training and evaluation on another device than the CPU."""

import pytest
import torch
from commands import TINY, room_file, train_config
from elsewhere import DEVICE, Elsewhere, device_elsewhere
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import OmegaConf
from parts import make_parts, train_in

from dirl.agent.mapping import ImageGraph
from dirl.config.saved import config_text
from dirl.config.schemas import Device
from dirl.evaluation.protocol import action_values
from dirl.perception.recognition import Learned
from dirl.perception.recognition.build import build_recogniser
from dirl.runs.checkpoints import load_checkpoint
from dirl.runs.paths import config_file
from dirl.scenes import World
from dirl.training.build import load_trained
from dirl.training.job import prepare_device, run_job

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


@pytest.fixture
def in_order(monkeypatch):
    """Whether kernels that add in a fixed order are chosen; none are before the test, and after it."""
    monkeypatch.setenv("CUBLAS_WORKSPACE_CONFIG", ":16:8")  # what the user chose stays
    yield torch.are_deterministic_algorithms_enabled
    torch.use_deterministic_algorithms(False)


def test_on_a_gpu_alone_kernels_are_chosen_that_add_in_a_fixed_order(in_order):
    prepare_device(Device.cpu)
    assert not in_order()
    prepare_device(Device.cuda)
    assert in_order()
    assert torch.is_deterministic_algorithms_warn_only_enabled()


def test_a_resumed_run_is_prepared_by_its_own_configuration(tmp_path, monkeypatch, elsewhere, in_order):
    folder = tmp_path / "run"
    folder.mkdir()
    config_file(folder).write_text(config_text(train_config(f"scene={room_file(tmp_path)}", *SMALL, "device=cuda")))
    resume = f"resume={folder}"
    hydra = {"runtime": {"output_dir": str(folder)}, "mode": RunMode.MULTIRUN, "overrides": {"task": [resume]}}
    monkeypatch.setattr(HydraConfig, "get", lambda: OmegaConf.create(hydra))
    chosen = []

    def stages(run, components):
        chosen.append(in_order())
        raise InterruptedError

    with pytest.raises(InterruptedError):
        run_job(OmegaConf.structured(train_config(resume)), stages)
    assert chosen == [True]
