"""Workers that update the same weights without a lock: asynchronous advantage actor-critic (Mnih et al. 2016).

Each worker is a process with agents of its own. It copies the shared weights, lets its agents walk, computes gradients
of its copy, and applies them to the shared weights even if others have changed these meanwhile (Hogwild). The
optimiser's statistics are shared in the same way, as in the published code of TD-DRL.

The order of the updates depends on the operating system, so that no two runs are equal, even with the same seed.
"""

import copy
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.sharedctypes import Synchronized
from multiprocessing.synchronize import Event
from typing import Any

import torch
import torch.multiprocessing
from torch import Tensor, nn
from torch.optim import Optimizer

from dirl.config.components import make
from dirl.config.schemas import ConfigError, TrainConfig
from dirl.models import ActorCritic, caching, plain_weights, recurrent_keys
from dirl.training.build import (
    build_demonstrations,
    build_env,
    build_losses,
    build_observation,
    build_world,
    learning_policy,
)
from dirl.training.loops import TrainState, Updates
from dirl.training.objectives import (
    TFRMSprop,
    bootstrap,
    clip_gradients,
    make_advantages,
    minibatches,
    set_learning_rate,
    trained_parameters,
)
from dirl.training.rollout import Report, collect, report


@dataclass
class Shared:
    """The state that all processes write; every tensor lies in shared memory."""

    weights: list[Tensor]
    statistics: list[dict[str, Tensor]]
    """The optimiser's, of each weight."""
    claimed: "Synchronized[int]"
    """Frames that workers have set out to walk, a ``multiprocessing.Value``, which has a lock."""
    going: Event
    """Cleared to let the workers wait, as while their policy is tested, a ``multiprocessing.Event``."""
    stopped: Event
    """Ask the workers to end, a ``multiprocessing.Event``."""
    initial: dict[str, Tensor] | None = None
    """What a training with ``init`` began with, by name: statistics of the features and names of heads among it."""


def share(policy: nn.Module, optimiser: Optimizer, frames: int) -> Shared:
    """Copy the weights to shared memory, and move the optimiser's statistics to it, which the workers then write.

    The policy stays on its own, see `fetch`. ``frames`` is how many the training has taken so far.
    """
    context = _context()
    going = context.Event()
    going.set()
    for parameter in policy.parameters():
        if not optimiser.state[parameter]:
            optimiser.state[parameter].update(_first_statistics(optimiser, parameter))
        for value in optimiser.state[parameter].values():
            value.share_memory_()
    return Shared(
        weights=[parameter.detach().clone().share_memory_() for parameter in policy.parameters()],
        statistics=[optimiser.state[parameter] for parameter in policy.parameters()],
        claimed=context.Value("q", frames),
        going=going,
        stopped=context.Event(),
    )


def _context() -> Any:
    """Return how workers start: as forks of a process that has only imported what they need, or as new interpreters."""
    methods = torch.multiprocessing.get_all_start_methods()
    context = torch.multiprocessing.get_context("forkserver" if "forkserver" in methods else "spawn")
    context.set_forkserver_preload([__name__])
    return context


def _first_statistics(optimiser: Optimizer, parameter: Tensor) -> dict[str, Tensor]:
    """Return what an optimiser starts from; it would make it itself, but in its own process only."""
    if isinstance(optimiser, torch.optim.Adam):
        moments = {name: torch.zeros_like(parameter) for name in ("exp_avg", "exp_avg_sq")}
        return {"step": torch.zeros(()), **moments}
    if isinstance(optimiser, TFRMSprop):
        return {"mean_square": torch.ones_like(parameter)}
    raise ConfigError(f"reinforcement.workers: workers share Adam's or TFRMSprop's statistics, not {type(optimiser)}'s")


@torch.no_grad()
def fetch(shared: Shared, policy: nn.Module) -> None:
    """Copy the shared weights into a policy."""
    for own, common in zip(policy.parameters(), shared.weights, strict=True):
        own.copy_(common)


@contextmanager
def waiting(shared: Shared, policy: nn.Module) -> Iterator[None]:
    """Let the workers wait within this context, each after its present update; the policy has the shared weights."""
    shared.going.clear()
    try:
        fetch(shared, policy)
        yield
    finally:
        shared.going.set()


def learn(state: TrainState, loop: Updates) -> None:
    """Train with several workers, as long as the loop goes on."""
    if not loop.goes_on:
        return
    config = state.config
    shared = share(state.policy, state.optimiser, state.frames)
    if config.init is not None:
        shared.initial = {name: value.detach().clone() for name, value in plain_weights(state.policy).items()}
    for update in asynchronous_updates(config, shared, loop):
        loop.record(update, waiting(shared, state.policy))
    fetch(shared, state.policy)


def asynchronous_updates(config: TrainConfig, shared: Shared, loop: Updates) -> Iterator[Report]:
    """Start the workers, and yield their reports as long as the loop goes on, or until all its frames are claimed.

    Raises:
        RuntimeError: a worker failed; it has printed why.
    """
    context = _context()
    listening: dict[Connection, Any] = {}  # a connection to each worker, and its process
    # Workers inherit it: Ctrl-C, which the terminal sends to all of them, is for this process to handle.
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        for number in range(config.reinforcement.workers):
            receiver, sender = context.Pipe(duplex=False)
            worker = context.Process(target=work, args=(config, shared, loop.total, number, sender), daemon=True)
            worker.start()
            sender.close()  # so that the worker's end is the only one, and its closing is noticed here
            listening[receiver] = worker
    finally:
        signal.signal(signal.SIGINT, before)
    failed = False
    ready: Any
    while listening:
        for ready in wait(list(listening)):
            if failed or not loop.goes_on:
                shared.stopped.set()
            try:
                names, frames, values = ready.recv()
                yield Report(names, frames, torch.from_numpy(values))
            except EOFError:
                worker = listening.pop(ready)
                worker.join()
                failed |= worker.exitcode != 0
    if failed:
        raise RuntimeError("a worker failed; what it printed is above")


def work(config: TrainConfig, shared: Shared, total: int, number: int, sender: Connection) -> None:
    """Run a worker, numbered from 0: collect a rollout, update and send a `Report`, until `claim` has none."""
    torch.set_num_threads(1)
    world = build_world(config)
    observation = build_observation(config, world)
    options, common = config.reinforcement, learning_policy(config, world, observation, shared.initial)
    policy: ActorCritic = copy.deepcopy(common)
    for parameter, weight in zip(common.parameters(), shared.weights, strict=True):
        parameter.data = weight
    optimiser = make("optimiser", config.optimiser, config.trust, params=trained_parameters(common))
    for parameter, statistics in zip(common.parameters(), shared.statistics, strict=True):
        optimiser.state[parameter].update(statistics)
    agents_in_all = options.agents_per_scene * len(world.scenes)
    # Not the same draws again in a run that goes on.
    seed = config.seed + 1_000_003 * (1 + number) + shared.claimed.value
    torch.manual_seed(seed)
    count = len(range(number, agents_in_all, options.workers))
    env = build_env(config, world, observation, policy, agents=count, seed=seed)
    agents = env.reset()
    operator, advantages = policy.operator(), make_advantages(options.gamma, options.lmbda)
    critic = operator.get_value_operator()
    compute_losses = build_losses(config, policy, world, build_demonstrations(config, world, observation))
    own, rate = list(policy.parameters()), optimiser.defaults["lr"]
    by_agent, several = bool(recurrent_keys(policy)), options.epochs * options.minibatches > 1
    while not shared.stopped.is_set():
        shared.going.wait()
        left = claim(shared, env.batch_size.numel() * options.n_steps, total)
        if left is None:
            break
        set_learning_rate(optimiser, rate * left)
        fetch(shared, policy)
        with caching(policy, learns=True):
            batch, agents = collect(env, operator, agents, options.n_steps)
            batch = advantages(bootstrap(compute_losses.rewarded(batch), critic))
            for part in minibatches(batch, options.epochs, options.minibatches, by_agent=by_agent):
                losses = compute_losses(part, left)
                policy.zero_grad()
                sum(value for name, value in losses.items() if name.startswith("loss_")).backward()
                norm = clip_gradients(own, options.max_grad_norm, per_variable=options.clip_per_variable)
                for parameter, mine in zip(common.parameters(), own, strict=True):
                    parameter.grad = mine.grad
                optimiser.step()
                if several:
                    fetch(shared, policy)
        names, frames, values = report(env, batch, losses.set("gradient_norm", norm).detach())
        sender.send((names, frames, values.numpy()))


def claim(shared: Shared, frames: int, total: int) -> float | None:
    """Reserve frames for a rollout; the fraction of the training that is left before them, or None if none is."""
    with shared.claimed.get_lock():
        claimed = shared.claimed.value
        if claimed >= total:
            return None
        shared.claimed.value += frames
    return float(1 - claimed / total)
