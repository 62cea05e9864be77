"""What ``recipes/train.py`` makes of a configuration, for tests that use its stages."""

from contextlib import nullcontext
from types import SimpleNamespace

import torch
from commands import train_config
from train import imitate, reinforce

from dirl.models import plain_weights
from dirl.runs.folder import Run
from dirl.training.build import (
    build_demonstrations,
    build_losses,
    build_observation,
    build_protocol,
    build_world,
    learning_policy,
)
from dirl.training.job import begin


def make_parts(*options):
    """``config``, ``world``, ``observation``, ``policy``, ``demos``, ``losses`` and ``protocol`` of these options."""
    config = train_config(*options)
    world = build_world(config)
    observation = build_observation(config, world)
    policy = learning_policy(config, world, observation)
    demos = build_demonstrations(config, world, observation)
    losses = build_losses(config, policy, world, demos)
    protocol = build_protocol(config, world, observation)
    torch.manual_seed(config.seed)
    return SimpleNamespace(
        config=config,
        world=world,
        observation=observation,
        policy=policy,
        demos=demos,
        losses=losses,
        protocol=protocol,
    )


def train_state(parts, saved=None):
    """The state before the first update, or as it was saved."""
    run = SimpleNamespace(config=parts.config, saved=saved, folder="run")
    return begin(run, parts.policy, parts.losses, parts.protocol)


def train_in(folder, parts):
    """Imitate, reinforce and finish as the recipe does; the summary of the reinforcement."""
    run = Run(folder, parts.config)
    state = begin(run, parts.policy, parts.losses, parts.protocol)
    run.begin(parts.world, parts.observation.order)
    if len(parts.demos):
        imitate([run], parts.policy, [parts.demos])
    result = reinforce(run, state, parts.protocol)
    run.finish({"frames": result["frames"], "network": plain_weights(parts.policy)}, {})
    return result


class Loop:
    """As `dirl.training.loops.Updates` without a run: updates until so many frames, or a state that is ``enough``."""

    def __init__(self, state, total, enough=lambda _: False):
        self.state, self.total, self.enough = state, total, enough
        self.stop, self.told = [], []
        state.left.fill_(1 - state.frames / total)

    @property
    def goes_on(self):
        return self.state.frames < self.total and not self.stop

    def record(self, report, paused=None):
        (update,) = report.read()
        with paused or nullcontext():
            self.state.frames += update.frames
            self.state.seconds += 1.0
            self.state.meter.add(update.goal_index, update.steps, self.state.frames)
        self.state.left.fill_(1 - self.state.frames / self.total)
        self.told.append(update.values)
        if self.enough(self.state):
            self.stop.append(1)
