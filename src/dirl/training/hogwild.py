"""Workers that update the same weights without a lock: asynchronous advantage actor-critic (Mnih et al. 2016).

Each worker is a process with agents of its own. It copies the shared weights, lets its agents walk, computes gradients
of its copy, and applies them to the shared weights whatever the others have made of these meanwhile (Hogwild). The
optimiser's statistics are shared in the same way, as in the published code of TD-DRL.

Who writes first is up to the machine, so that no two such runs are equal, whatever the seed.
"""

import copy
import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any

import torch
import torch.multiprocessing
from torch import Tensor
from torch.optim import Optimizer

from dirl.config.schemas import Precision, TrainConfig
from dirl.models import Network, actor_critic
from dirl.training.build import build_env, build_optimiser, learning_parts
from dirl.training.losses import Update, make_gradients, set_learning_rate, summarise
from dirl.training.rollout import collect


@dataclass
class Shared:
    """What all processes write to; every tensor lies in shared memory."""

    weights: list[Tensor]
    statistics: list[dict[str, Tensor]]
    """The optimiser's, of each weight."""
    claimed: Any
    """Frames that workers have set out to walk, a ``multiprocessing.Value``, which has a lock."""
    going: Any
    """Cleared to let the workers wait, as while their policy is tested, a ``multiprocessing.Event``."""
    stopped: Any
    """Ask the workers to end, a ``multiprocessing.Event``."""


def share(network: Network, optimiser: Optimizer, frames: int) -> Shared:
    """Copy the weights to shared memory, and move the optimiser's statistics there.

    Args:
        network: it stays on its own; see `fetch`.
        optimiser: of its parameters; its statistics are from now on those that the workers write.
        frames: that the training has taken so far.
    """
    context = torch.multiprocessing.get_context("spawn")
    going = context.Event()
    going.set()
    for parameter in network.parameters():
        if not optimiser.state[parameter]:
            optimiser.state[parameter].update(_first_statistics(optimiser, parameter))
        for value in optimiser.state[parameter].values():
            value.share_memory_()
    return Shared(
        weights=[parameter.detach().clone().share_memory_() for parameter in network.parameters()],
        statistics=[optimiser.state[parameter] for parameter in network.parameters()],
        claimed=context.Value("q", frames),
        going=going,
        stopped=context.Event(),
    )


def _first_statistics(optimiser: Optimizer, parameter: Tensor) -> dict[str, Tensor]:
    """What an optimiser starts from; it would make it itself, but in its own process only."""
    if isinstance(optimiser, torch.optim.Adam):
        moments = {name: torch.zeros_like(parameter) for name in ("exp_avg", "exp_avg_sq")}
        return {"step": torch.zeros(()), **moments}
    return {"mean_square": torch.ones_like(parameter)}


@torch.no_grad()
def fetch(shared: Shared, network: Network) -> None:
    """Copy the shared weights into a network."""
    for own, common in zip(network.parameters(), shared.weights, strict=True):
        own.copy_(common)


@contextmanager
def waiting(shared: Shared, network: Network) -> Iterator[None]:
    """Within this context the workers wait, each once it has ended its update; the network has the shared weights."""
    shared.going.clear()
    try:
        fetch(shared, network)
        yield
    finally:
        shared.going.set()


def asynchronous_updates(
    config: TrainConfig, shared: Shared, total: int, interrupted: Sequence[int]
) -> Iterator[Update]:
    """Start the workers, and yield what they tell until ``total`` frames are walked.

    Args:
        config: of the run; each worker makes the parts from it anew.
        shared: see `share`.
        total: frames of the whole training.
        interrupted: the workers end once there is anything in it.

    Raises:
        RuntimeError: a worker failed; it has printed why.
    """
    context = torch.multiprocessing.get_context("spawn")
    listening: dict[Any, Any] = {}  # a connection to each worker, and its process
    # Workers inherit it: Ctrl-C, which the terminal sends to all of them, is for this process to handle.
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        for number in range(config.reinforcement.workers):
            receiver, sender = context.Pipe(duplex=False)
            worker = context.Process(target=work, args=(config, shared, total, number, sender), daemon=True)
            worker.start()
            sender.close()  # so that the worker's end is the only one, and its closing is noticed here
            listening[receiver] = worker
    finally:
        signal.signal(signal.SIGINT, before)
    failed = False
    ready: Any
    while listening:
        for ready in wait(list(listening)):
            if interrupted or failed:
                shared.stopped.set()
            try:
                yield ready.recv()
            except EOFError:
                worker = listening.pop(ready)
                worker.join()
                failed |= worker.exitcode != 0
    if failed:
        raise RuntimeError("a worker failed; what it printed is above")


def work(config: TrainConfig, shared: Shared, total: int, number: int, sender: Connection) -> None:
    """The life of a worker: walk and update, as long as there are frames left.

    Args:
        config: of the run.
        shared: see `share`.
        total: frames of the whole training.
        number: of the worker, from 0.
        sender: an `Update` is sent there after each.
    """
    torch.set_num_threads(1)
    parts = learning_parts(config)
    options, network = config.reinforcement, copy.deepcopy(parts.network)
    for parameter, common in zip(parts.network.parameters(), shared.weights, strict=True):
        parameter.data = common
    optimiser = build_optimiser(parts)
    for parameter, statistics in zip(parts.network.parameters(), shared.statistics, strict=True):
        optimiser.state[parameter].update(statistics)
    agents_in_all = options.agents_per_scene * len(parts.world.scenes)
    # Not the same draws again in a run that goes on.
    seed = config.seed + 1_000_003 * (1 + number) + shared.claimed.value
    torch.manual_seed(seed)
    env = build_env(parts, agents=len(range(number, agents_in_all, options.workers)), seed=seed)
    agents = env.reset()
    rounds = config.precision == Precision.bfloat16
    operator, gradients = actor_critic(network), make_gradients(parts, network)
    while not shared.stopped.is_set():
        shared.going.wait()
        with shared.claimed.get_lock():
            claimed = shared.claimed.value
            if claimed >= total:
                break
            shared.claimed.value += env.batch_size.numel() * options.steps
        left = 1 - claimed / total
        set_learning_rate(optimiser, config.optimiser.lr * left)
        fetch(shared, network)
        with network.encoder.remembering(), torch.autocast("cpu", torch.bfloat16, enabled=rounds):
            batch, agents = collect(env, operator, agents, options.steps)
            for result in gradients(batch, left):  # noqa: B007
                for parameter, own in zip(parts.network.parameters(), network.parameters(), strict=True):
                    parameter.grad = own.grad
                optimiser.step()
                if config.objective.epochs * config.objective.minibatches > 1:
                    fetch(shared, network)
        sender.send(summarise(env, batch, result))
