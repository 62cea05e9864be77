"""Checks that the training state in a checkpoint fits the run that is to be resumed from it."""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor
from torch.optim import Optimizer
from torchrl.envs import EnvBase

from dirl.runs.checks import RunError, is_count


def check_fits(saved: Any, fresh: Any, where: str, most: int = 2**63 - 1) -> None:
    """Raise `RunError` unless a saved state fits the owner of a fresh state.

    Tensors must agree in shape and dtype, dictionaries in their keys, lists in their length; an empty fresh dictionary
    is one that fills up, and tells nothing of what may be in it; an empty fresh list fills with counts.

    Args:
        saved: of a checkpoint, as `load_checkpoint` returns it.
        fresh: of the same kind, as ``state_dict()`` gives it before any training; None is a count that
            is not known yet.
        where: the file and what it is of, for the error.
        most: the largest count there can be, as of frames so far.
    """
    if isinstance(fresh, Tensor):
        if not isinstance(saved, Tensor) or saved.shape != fresh.shape or saved.dtype != fresh.dtype:
            raise RunError(f"{where}: expected {_told(fresh)}, found {_told(saved)}")
    elif isinstance(fresh, Mapping):
        if not isinstance(saved, Mapping) or (fresh and saved.keys() != fresh.keys()):
            raise RunError(f"{where}: expected {_told(fresh)}, found {_told(saved)}")
        for key, inner in fresh.items():
            check_fits(saved[key], inner, f"{where}.{key}", most)
    elif isinstance(fresh, list | tuple):
        _check_list(saved, fresh, where, most)
    elif not _same_kind(saved, fresh, most):
        raise RunError(f"{where}: expected {_told(fresh)}, found {_told(saved)}")


def _check_list(saved: Any, fresh: list[Any] | tuple[Any, ...], where: str, most: int) -> None:
    if not isinstance(saved, list | tuple) or (fresh and len(saved) != len(fresh)):
        raise RunError(f"{where}: expected {_told(fresh)}, found {_told(saved)}")
    if not fresh and not all(is_count(value) and value <= most for value in saved):
        raise RunError(f"{where}: expected counts up to {most}")
    for index, inner in enumerate(fresh):
        check_fits(saved[index], inner, f"{where}[{index}]", most)


def _same_kind(saved: Any, fresh: Any, most: int) -> bool:
    if fresh is None and saved is None:
        return True
    if fresh is None or type(fresh) is int:
        return is_count(saved) and saved <= most
    return type(saved) in (int, float) if isinstance(fresh, float) else type(saved) is type(fresh)


def _told(value: Any) -> str:
    if isinstance(value, Tensor):
        return f"{str(value.dtype).removeprefix('torch.')} {list(value.shape)}"
    if isinstance(value, Mapping):
        names = ", ".join(map(str, sorted(value, key=str)[:5]))
        return f"{len(value)} entries ({names}{', ...' if len(value) > 5 else ''})"
    if isinstance(value, list | tuple):
        return f"a list of {len(value)}"
    return "a count or nothing" if value is None else f"{type(value).__name__} {value!r}"[:80]


def check_optimiser(saved: Any, optimiser: Optimizer, where: str, trained: Any) -> None:
    """Raise `RunError` unless a saved state is one that an optimiser can take: `check_fits`, and of each parameter.

    Args:
        saved: its ``state_dict()`` in a checkpoint.
        optimiser: a fresh one of the same parameters.
        where: the file and what it is of, for the error.
        trained: how many parameters have a state; those without gradients so far have none.
    """
    fresh = optimiser.state_dict()
    check_fits(saved, {**fresh, "state": {}}, where)
    parameters = [parameter for group in optimiser.param_groups for parameter in group["params"]]
    for group, wanted in zip(saved["param_groups"], fresh["param_groups"], strict=True):
        changed = [name for name in wanted if name != "lr" and group[name] != wanted[name]]
        if changed or not 0 <= group["lr"] <= optimiser.defaults["lr"]:  # schedules only lower it
            raise RunError(f"{where}.param_groups: {', '.join(changed or ['lr'])} cannot have been so in this run")
    if not saved["state"].keys() <= set(range(len(parameters))) or len(saved["state"]) != trained:
        raise RunError(
            f"{where}.state: expected {trained!r:.80} of {len(parameters)} parameters, found {_told(saved['state'])}"
        )
    first: Any = next(iter(saved["state"].values()), None)
    for index, values in saved["state"].items():
        kinds = [(parameters[index].shape, parameters[index].dtype), (torch.Size(), torch.float32)]
        if not isinstance(values, dict) or not all(
            isinstance(value, Tensor) and (value.shape, value.dtype) in kinds for value in values.values()
        ):
            raise RunError(f"{where}.state.{index}: expected {_told(parameters[index])}, or single numbers")
        step = values.get("step", torch.ones(()))
        if not (step.isfinite().all() and (step >= 1).all() and (step == step.floor()).all()):
            raise RunError(f"{where}.state.{index}.step: expected a count of steps, found {step.tolist()!r:.40}")
        if values.keys() != first.keys():
            raise RunError(f"{where}.state.{index}: has other entries than that of the first parameter")


def check_random_state(saved: Any, where: str) -> None:
    """Raise `RunError` unless a tensor is the state of a random number generator of the CPU."""
    try:
        torch.Generator().set_state(saved)
    except (TypeError, RuntimeError) as error:
        raise RunError(f"{where}: is no state of a random number generator ({str(error).splitlines()[0]})") from None


def check_agents(saved: Any, env: EnvBase, where: str) -> None:
    """Raise `RunError` unless saved agents are valid states of the environment: see its specs.

    Args:
        saved: what the environment's ``reset`` returned, or a step later, as a dictionary of tensors of those shapes.
        env: batched, with a spec of everything in it.
        where: the file and what it is of, for the error.
    """
    for specs in (env.full_observation_spec, env.full_done_spec):
        for name, spec in specs.items():
            if not spec.is_in(saved[name]):
                raise RunError(f"{where}.{name}: holds values that the environment does not have")


def check_training(
    saved: Mapping[str, Any], fresh: Mapping[str, Any], env: EnvBase, optimiser: Optimizer, where: str
) -> None:
    """Raise `RunError` unless a training can be resumed from a checkpoint; call it before restoring anything.

    Args:
        saved: of `dirl.runs.checkpoints.load_checkpoint`.
        fresh: what the recipe would save now, before any training: ``learning``, ``agents``, ``meter`` and ``random``.
        env: of the training.
        optimiser: of the training.
        where: the checkpoint, for the error.
    """
    missing = fresh.keys() - saved.keys()
    if missing:
        raise RunError(f"{where}: is no checkpoint of a training; it lacks {', '.join(sorted(missing))}")
    for name in fresh.keys() - {"optimiser", "random", "trained"}:
        check_fits(saved[name], fresh[name], f"{where}: {name}", saved["frames"])
    if [sum(lengths) for lengths in saved["meter"]["steps"]] != list(saved["meter"]["totals"]):
        raise RunError(f"{where}: meter: the lengths of the latest episodes do not add up to their totals")
    check_agents(saved["agents"], env, f"{where}: agents")
    check_optimiser(saved["optimiser"], optimiser, f"{where}: optimiser", saved["trained"])
    if saved["frames"] and not saved["optimiser"]["state"]:
        raise RunError(f"{where}: optimiser.state: is empty, though {saved['frames']} frames were trained")
    _check_random(saved["random"], fresh["random"], where)


def check_imitation(
    saved: Mapping[str, Any], fresh: Mapping[str, Any], optimiser: Optimizer, steps: int, where: str
) -> None:
    """Raise `RunError` unless an imitation can be resumed from a checkpoint; call it before restoring anything.

    Args:
        saved: of `dirl.runs.checkpoints.load_checkpoint`.
        fresh: what the recipe would save now, before any step.
        optimiser: of the imitation.
        steps: that it takes at most.
        where: the checkpoint, for the error.
    """
    missing = fresh.keys() - saved.keys()
    if missing:
        raise RunError(f"{where}: is no checkpoint of an imitation; it lacks {', '.join(sorted(missing))}")
    check_fits(saved["imitation"], fresh["imitation"], f"{where}: imitation", steps)
    check_fits(saved["learning"], fresh["learning"], f"{where}: learning")
    check_optimiser(saved["optimiser"], optimiser, f"{where}: optimiser", saved["trained"])
    if not saved["optimiser"]["state"]:
        raise RunError(f"{where}: optimiser.state: is empty, though an imitation was saved after its first step")
    _check_random(saved["random"], fresh["random"], where)


def _check_random(saved: Any, fresh: Mapping[str, Any], where: str) -> None:
    check_fits(saved, fresh, f"{where}: random")
    for name, state in saved.items():
        if name != "cuda":
            check_random_state(state, f"{where}: random.{name}")
