"""What ``recipes/train.py`` makes of a configuration, for tests that use its stages."""

from contextlib import nullcontext
from types import SimpleNamespace

import torch
from commands import train_config
from train import imitate, reinforce

from dirl.config.components import make
from dirl.evaluation.protocol import EpisodeMeter
from dirl.models import plain_weights
from dirl.runs.checkpoints import restoring
from dirl.runs.folder import Run
from dirl.training.build import (
    build_demonstrations,
    build_env,
    build_losses,
    build_observation,
    build_protocol,
    build_world,
    learning_policy,
)
from dirl.training.loops import TrainState
from dirl.training.objectives import trained_parameters


def make_parts(*options):
    """``config``, ``world``, ``observation``, ``policy``, ``demos``, ``losses`` and ``protocol`` of these options."""
    made = SimpleNamespace(config=train_config(*options))
    made.world = build_world(made.config)
    made.observation = build_observation(made.config, made.world)
    made.policy = learning_policy(made.config, made.world, made.observation)
    made.demos = build_demonstrations(made.config, made.world, made.observation)
    made.losses = build_losses(made.config, made.policy, made.world, made.demos)
    made.protocol = build_protocol(made.config, made.world, made.observation)
    torch.manual_seed(made.config.seed)
    return made


def train_state(parts, saved=None):
    """The state before the first update, or as it was saved."""
    config, policy, losses = parts.config, parts.policy, parts.losses
    trained = trained_parameters(policy, losses)
    optimiser = make("optimiser", config.optimiser, params=trained)
    env, meter = build_env(config, parts.world, parts.observation, policy), EpisodeMeter(len(parts.world.goals))
    state = TrainState(config, policy, losses, trained, optimiser, env, env.reset(), meter)
    if saved is not None:
        with restoring("run"):
            state.load_state_dict(saved)
    return state


def train_in(folder, parts):
    """Imitate, reinforce and finish as the recipe does; the summary of the reinforcement."""
    run = Run(folder, parts.config)
    state = train_state(parts)
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
