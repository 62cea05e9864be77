"""The state of a training: what a checkpoint holds, so that a killed run resumes to the same result."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn
from torch.optim import Optimizer
from torchrl.envs import EnvBase

from dirl.evaluation.stability import EpisodeMeter
from dirl.models import plain_weights
from dirl.training.losses import Losses, trained_parameters
from dirl.training.rollout import Update, summarise


@dataclass
class TrainState:
    """Everything that changes between updates."""

    policy: Any
    """See `dirl.models.ActorCritic`."""
    losses: Losses
    optimiser: Optimizer
    env: EnvBase
    agents: TensorDictBase
    """Where the agents stand, ``[B]``."""
    meter: EpisodeMeter
    frames: int = 0
    seconds: float = 0.0
    """Spent on updates, without evaluation."""
    began: float = field(default_factory=time.perf_counter)
    """When the current update began."""
    generator: torch.Generator | None = None
    """In a stack that of the run's actions; else they are drawn by torch's own."""

    stacked: ClassVar[bool] = False
    """True if the first dimension of everything is the run, see `dirl.training.stacked.Stack`."""

    @property
    def parameters(self) -> list[nn.Parameter]:
        """What is trained: the policy's parameters and the losses' own."""
        return trained_parameters(self.policy, self.losses)

    def prepared(self, update: Callable[[], Any]) -> Callable[[], Any]:
        """The update as it is called; that of a stack is a CUDA graph."""
        return update

    def summarise(self, batch: TensorDictBase, losses: TensorDictBase) -> Update:
        """The report of an update."""
        return summarise(self.env, batch, losses)

    @property
    def summary(self) -> dict[str, Any]:
        """What the summary of a run says of its reinforcement."""
        stable = {"stable_at_frame": self.meter.stable_at, "near_shortest_at_frame": self.meter.near_at}
        return {"frames": self.frames, "frames_per_second": self.frames / self.seconds, **stable}

    def start_clock(self) -> None:
        """Start to time an update."""
        self.began = time.perf_counter()

    def count(self, update: Update) -> None:
        """Count a finished update."""
        self.seconds += time.perf_counter() - self.began
        self.frames += update.frames
        self.meter.add(update.goal_index, update.steps, self.frames)

    def state_dict(self) -> dict[str, Any]:
        """What `load_state_dict` takes, and under ``network`` the weights for everyone else."""
        return {
            "frames": self.frames,
            "training_seconds": self.seconds,
            "network": plain_weights(self.policy),
            "learning": self.policy.state_dict(),
            "losses": self._own_of_losses(),
            "optimiser": plain_optimiser(self.optimiser),
            "agents": self.agents.cpu().to_dict(),
            "meter": self.meter.state_dict(),
            "random": {"env": self.env.base_env.generator.get_state(), **self._random_state()},
        }

    def _random_state(self) -> dict[str, Tensor]:
        own = {} if self.generator is None else {"cpu": self.generator.get_state()}
        return random_state(self.env.device) | own

    def _own_of_losses(self) -> dict[str, Any]:
        """The part of the losses' state_dict that is not the policy's: weights, buffers, extra state."""
        shared = {_place(value) for value in (*self.policy.parameters(), *self.policy.buffers())}
        return {name: value for name, value in self.losses.state_dict().items() if _place(value) not in shared}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore a saved state."""
        self.frames, self.seconds = state["frames"], state["training_seconds"]
        self.policy.load_state_dict(state["learning"])
        self.losses.load_state_dict({**self.losses.state_dict(), **state["losses"]})
        self.optimiser.load_state_dict(state["optimiser"])
        agents = TensorDict(state["agents"], batch_size=self.env.batch_size, device=self.env.device)
        self.agents = self.env.base_env.restore_agents(agents)
        self.meter.load_state_dict(state["meter"])
        self.env.base_env.generator.set_state(state["random"]["env"])
        restore_random_state(state["random"])


def plain_optimiser(optimiser: Optimizer) -> dict[str, Any]:
    """The state_dict of an optimiser, with numbers for what are tensors while it is captured in a graph."""
    state = optimiser.state_dict()
    for group in state["param_groups"]:
        if isinstance(group["lr"], Tensor):
            group.update(lr=float(group["lr"]), capturable=False)
    return state


def _place(value: Any) -> Any:
    """What two entries of state_dicts have in common if they are one tensor."""
    return value.data_ptr() if isinstance(value, Tensor) and value.numel() else id(value)


def random_state(device: torch.device) -> dict[str, Tensor]:
    """The state of torch's own generators, from which actions and pairs are sampled."""
    own = {} if device.type == "cpu" else {device.type: torch.get_device_module(device).get_rng_state()}
    return {"cpu": torch.get_rng_state(), **own}


def restore_random_state(state: Mapping[str, Tensor]) -> None:
    """Restore the generators' states that `random_state` returned."""
    torch.set_rng_state(state["cpu"])
    for device in state.keys() - {"cpu", "env"}:
        torch.get_device_module(device).set_rng_state(state[device])
