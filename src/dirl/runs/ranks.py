"""Ranks: the processes that ``torchrun`` starts, which train one policy together on ``torch.distributed``.

Every rank holds the whole world and policy. It walks with its share of the agents, or samples its share of the pairs;
gradients are averaged before each optimiser step, so that the weights of all ranks stay the same. Rank 0 alone writes
the run's folder, evaluates, and prints. Without ``torchrun`` there is rank 0 only, and every function here is trivial.

`torch.nn.parallel.DistributedDataParallel` is not used: it wraps one ``forward``, and an update here calls trunk, heads
and losses one by one.
"""

import atexit
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import contextmanager
from datetime import timedelta
from typing import Any, TypeVar

import torch
import torch.distributed as dist
from torch import nn
from torch.distributed.rendezvous import rendezvous

from dirl.config.schemas import ConfigError, Reduction, TrainConfig
from dirl.runs import exits
from dirl.runs.finding import RunError

T = TypeVar("T")

PATIENCE = timedelta(hours=6)
"""How long a rank waits for the others: rank 0 evaluates and draws meanwhile. A rank that died is noticed at once."""

SEEDS = 1_000_003
"""Between the seeds of two ranks."""


def join() -> None:
    """Meet the other ranks, if ``torchrun`` has started this process with any."""
    if int(os.environ.get("WORLD_SIZE", "1")) == 1 or dist.is_initialized():
        return
    store, number, count = next(rendezvous("env://", timeout=PATIENCE))
    backend = "cpu:gloo,cuda:nccl" if torch.cuda.is_available() else "gloo"
    dist.init_process_group(backend, store=store, rank=number, world_size=count, timeout=PATIENCE)
    atexit.register(dist.destroy_process_group)
    exits.is_first = lambda: store.add("has spoken", 1) == 1
    if number:
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115, for the rest of the process


def check(config: TrainConfig, *, alone: bool) -> None:
    """Check that ranks can share a training, if there are several; see `share_of_agents` for reinforcement.

    Raises:
        ConfigError: they cannot, or the run is not ``alone`` but a job of a sweep.
    """
    if size() == 1:
        return
    asked = f"torchrun with {size()} ranks"
    if not alone:
        raise ConfigError(f"{asked}: trains one run; start the jobs of a sweep (-m) without torchrun")
    if config.reinforcement.workers > 1:
        workers = f"reinforcement.workers={config.reinforcement.workers}"
        raise ConfigError(f"{asked}: {workers}: asynchronous workers share one machine's memory; use one of the two")
    if config.imitation.rounds:
        raise ConfigError(f"{asked}: imitation.rounds={config.imitation.rounds}: DAgger runs in one process only")


def rank() -> int:
    """The number of this process, from 0."""
    return dist.get_rank() if dist.is_initialized() else 0


def size() -> int:
    """The number of ranks."""
    return dist.get_world_size() if dist.is_initialized() else 1


def share(count: int) -> int:
    """How many of so many things this rank takes."""
    return len(range(rank(), count, size()))


def share_of_agents(config: TrainConfig, scenes: int) -> int:
    """How many agents walk in this rank.

    Raises:
        ConfigError: the agents cannot be shared equally, or the losses are added up instead of averaged.
    """
    options = config.reinforcement
    agents = options.agents_per_scene * scenes
    if size() > 1 and options.reduction == Reduction.sum:
        raise ConfigError(
            "reinforcement.reduction=sum: ranks average their gradients; use reinforcement.reduction=mean"
        )
    if agents % size():
        raise ConfigError(
            f"reinforcement.agents_per_scene={options.agents_per_scene}: {agents} agents cannot be shared equally by "
            f"{size()} ranks"
        )
    return agents // size()


def own_seed(seed: int) -> int:
    """The seed of what this rank draws; that of rank 0 is the seed itself."""
    return (seed + SEEDS * rank()) % 2**63


def average_gradients(parameters: Iterable[nn.Parameter], rows: int) -> None:
    """Replace gradients by their mean over the ranks, weighted by the rows over which the loss of each is a mean.

    The parameters with gradients must be the same in every rank.

    Raises:
        LostRankError: another rank has ended.
    """
    if size() == 1:
        return
    gradients = [parameter.grad for parameter in parameters if parameter.grad is not None]
    flat = torch.cat([*(gradient.flatten() for gradient in gradients), gradients[0].new_ones(1)]).mul_(rows)
    with _noticing_losses():
        dist.all_reduce(flat)
    flat /= flat[-1].clone()
    for gradient, mean in zip(gradients, flat[:-1].split([g.numel() for g in gradients]), strict=True):
        gradient.copy_(mean.view_as(gradient))


def gather(value: T) -> list[T]:
    """What each rank has, by rank; plain values and tensors of the CPU.

    Raises:
        LostRankError: another rank has ended.
    """
    if size() == 1:
        return [value]
    values: list[Any] = [None] * size()
    with _noticing_losses():
        dist.all_gather_object(values, value)
    return values


def tell(value: T, signals: Sequence[int], save: bool) -> tuple[list[T], list[int], bool]:
    """What ranks tell each other after an update, so that all of them stop and save after the same one.

    A value, the signals that a rank has got, and whether its clock says that a checkpoint is due become the values of
    all ranks, the signals that any has got, and what rank 0's clock says.
    """
    values, found, saves = zip(*gather((value, list(signals), save)), strict=True)
    return list(values), [number for those in found for number in those], saves[0]


def from_first(make: Callable[[], T]) -> T:
    """What a function returns in rank 0, or raises there; it is not called in others.

    Raises:
        LostRankError: another rank has ended.
    """
    if size() == 1:
        return make()
    outcome: list[Any] = [None, None]
    if rank() == 0:
        try:
            outcome[0] = make()
        except (ValueError, OSError) as error:
            outcome[1] = error
    with _noticing_losses():
        dist.broadcast_object_list(outcome)
    if outcome[1] is not None:
        raise outcome[1]
    return outcome[0]


@torch.no_grad()
def agree(policy: nn.Module) -> None:
    """Give every rank the weights of rank 0: another machine may find other principal axes, or round otherwise."""
    differs = False
    for value in policy.state_dict().values() if size() > 1 else ():
        before = value.clone()
        dist.broadcast(value, 0)
        differs |= not torch.equal(before, value)
    if differs:
        policy.load_state_dict(policy.state_dict())  # which computes anew what follows from them


def own_part(saved: Mapping[str, Any], where: str) -> dict[str, Any]:
    """A checkpoint as this rank goes on from it, see `with_others`.

    Raises:
        RunError: it is of another number of ranks.
    """
    others = saved.get("others", ())
    if len(others) + 1 != size():
        raise RunError(f"{where}: was trained by {len(others) + 1} ranks, not {size()}; resume it with as many")
    return {**saved, **(others[rank() - 1] if rank() else {})}


def with_others(state: Mapping[str, Any], names: Sequence[str]) -> dict[str, Any]:
    """The state of a training with those entries of the other ranks that differ from rank to rank, for a checkpoint."""
    others = gather({name: state[name] for name in names})[1:]
    return {**state, **({"others": others} if others else {})}


@contextmanager
def _noticing_losses() -> Any:
    """Within this context what torch says of a connection that broke is told as what it means."""
    try:
        yield
    except RuntimeError as error:
        if not any(word in str(error) for word in ("onnection", "imed out", "NCCL")):
            raise
        raise exits.LostRankError from None  # torchrun reports which, and by what signal
