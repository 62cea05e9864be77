"""Our training, rollout and evaluation, timed."""

import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from hydra import compose
from torch.utils.flop_counter import FlopCounterMode

from dirl.cli.command_line import prepare
from dirl.config.schemas import TrainConfig, typed
from dirl.models import caching
from dirl.runs.folder import Run
from dirl.runs.memory import peak_memory_mb
from dirl.training.build import (
    build_demonstrations,
    build_env,
    build_losses,
    build_observation,
    build_protocol,
    build_world,
)
from dirl.training.job import begin
from dirl.training.load import learning_policy
from dirl.training.rollout import collect

ROOT = Path(__file__).resolve().parent.parent
CONF = ROOT / "conf"

sys.path.insert(0, str(ROOT / "recipes"))
from train import imitate, reinforce  # noqa: E402

__all__ = ["evaluation_seconds", "learning", "operations_per_frame", "peak_memory_mb", "rollout", "trained", "training"]


def train_config(overrides: Sequence[str]) -> TrainConfig:
    """A configuration of recipes/train.py in which nothing but training takes time."""
    quiet = ["evaluation.times=0", "checkpoint.every_seconds=1e9"]
    config: TrainConfig = typed(compose("train", prepare(TrainConfig, [*quiet, *overrides], CONF)))
    return config


def trained(config: TrainConfig, *, imitation: bool = False) -> dict[str, Any]:
    """Train in a folder that is thrown away."""
    world = build_world(config)
    observation = build_observation(config, world)
    policy = learning_policy(config, world, observation)
    demos = build_demonstrations(config, world, observation)
    losses = build_losses(config, policy, world, demos)
    protocol = build_protocol(config, world, observation)
    with tempfile.TemporaryDirectory() as folder:
        run = Run(Path(folder), config)
        state = begin(run, policy, losses, protocol)
        run.begin(world, observation.order)
        torch.manual_seed(config.seed)
        if imitation:
            imitate(run, policy, demos)
        result: dict[str, Any] = reinforce(run, state, protocol)
        run.close()
        return result


def training(config: TrainConfig) -> float:
    """Frames per second of our training loop."""
    return float(trained(config)["frames_per_second"])


def rollout(config: TrainConfig, updates: int) -> float:
    """Frames per second of walking alone."""
    world = build_world(config)
    observation = build_observation(config, world)
    policy: Any = learning_policy(config, world, observation)
    env, operator = build_env(config, world, observation, policy), policy.operator()
    agents, frames = env.reset(), 0
    began = time.perf_counter()
    for _ in range(updates):
        with caching(policy):
            batch, agents = collect(env, operator, agents, config.reinforcement.n_steps)
        frames += batch.numel()
    return frames / (time.perf_counter() - began)


def learning(config: TrainConfig) -> dict[str, float]:
    """When a whole training became stable: at which frame, and after how many seconds (imitation included)."""
    began = time.perf_counter()
    result = trained(config, imitation=True)
    seconds = time.perf_counter() - began
    stable, frames = result["stable_at_frame"], result["frames"]
    # All frames take about equally long.
    before = seconds - frames / result["frames_per_second"]
    return {"stable_at_frame": stable, "stable_at_second": stable and before + stable / result["frames_per_second"]}


def operations_per_frame(config: TrainConfig) -> float:
    """Floating-point operations of matrix products that our training loop makes for a frame."""
    with FlopCounterMode(display=False) as counter:
        result = trained(config)
    return float(counter.get_total_flops() / result["frames"])


def evaluation_seconds(config: TrainConfig) -> dict[str, Any]:
    """How long episodes take, with the network as it begins, which walks longest: every start, and 100,000 sampled."""
    world = build_world(config)
    observation = build_observation(config, world)
    policy = learning_policy(config, world, observation)
    every = build_protocol(config, world, observation)
    goal_index, start = every.starts
    draws = torch.randint(len(start), (100_000,))
    many = replace(every, starts=(goal_index[draws], start[draws]))
    result: dict[str, Any] = {"episodes": len(start)}
    for name, protocol, greedy in (("greedy_seconds", every, True), ("sampled_100k_seconds", many, False)):
        began = time.perf_counter()
        protocol.run(policy, greedy=greedy)
        result[name] = time.perf_counter() - began
    return result
