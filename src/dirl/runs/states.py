"""Checks that the training state in a checkpoint fits the run that is to be resumed from it."""

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.optim import Optimizer
from torchrl.envs import EnvBase

from dirl.config.schemas import TrainConfig
from dirl.runs.contents import TABLES
from dirl.runs.finding import RunError


def check_progress(file: Path, state: Mapping[str, Any], config: TrainConfig) -> None:
    """Raise `RunError` unless a run with these options can have a checkpoint's counts."""
    missing = {"schema", "tables", "seconds", "turns"} - state.keys()
    if missing:
        raise RunError(f"{file}: is no checkpoint of a training; it lacks {' and '.join(sorted(missing))}")
    options, scenes = config.reinforcement, len(state["scenes"])
    most = scenes * (options.frames_per_scene + options.agents_per_scene * options.n_steps)  # the last rollout is whole
    if state["frames"] != int(file.stem) or state["frames"] > most:
        raise RunError(f"{file}: counts {state['frames']} frames, where its name and options have others")
    for table in (file.parent.parent / name for name in TABLES if name not in state["tables"]):
        if table.is_file() and _begins_before(table, state["frames"]):
            raise RunError(f"{file}: knows nothing of {table}, whose rows would be lost")
    for name, size in state["tables"].items():
        table = file.parent.parent / name
        if not table.is_file() or table.stat().st_size < size:
            raise RunError(f"{file}: does not fit {table}, which is shorter than it was, or missing")


def _begins_before(table: Path, frames: int) -> bool:
    """Whether the first row of a table is older than a checkpoint at so many frames; rows without frames always are."""
    with table.open(newline="", errors="replace") as stream:
        row = next(csv.DictReader(stream), None)
    if row is None:
        return False
    try:
        return "frames" not in row or (frames > 0 and float(row["frames"]) <= frames)
    except (TypeError, ValueError):
        return True


def check_state(
    saved: Mapping[str, Any],
    fresh: Mapping[str, Any],
    optimiser: Optimizer,
    where: str,
    most: int,
    env: EnvBase | None = None,
) -> None:
    """Raise `RunError` unless a training can be resumed from a checkpoint; call it before restoring anything.

    Args:
        saved: of `dirl.runs.checkpoints.load_checkpoint`.
        fresh: what the run would save now, before any step.
        optimiser: of the training.
        where: the checkpoint, for the error.
        most: the largest count there can be, of frames so far or of steps.
        env: of a reinforcement; None for an imitation, which saves nothing before its first step.
    """
    missing = fresh.keys() - saved.keys()
    if missing:
        stage = "an imitation" if env is None else "a training"
        raise RunError(f"{where}: is no checkpoint of {stage}; it lacks {', '.join(sorted(missing))}")
    for name in fresh.keys() - {"optimiser", "random", "trained"}:
        check_fits(saved[name], fresh[name], f"{where}: {name}", most)
    if env is not None:
        if [sum(lengths) for lengths in saved["meter"]["steps"]] != list(saved["meter"]["totals"]):
            raise RunError(f"{where}: meter: the lengths of the latest episodes do not add up to their totals")
        check_agents(saved["agents"], env, f"{where}: agents")
    check_optimiser(saved["optimiser"], optimiser, f"{where}: optimiser", saved["trained"])
    if not saved["optimiser"]["state"] and (env is None or saved["frames"]):
        raise RunError(f"{where}: optimiser.state: is empty, though the training had begun")
    check_fits(saved["random"], fresh["random"], f"{where}: random")
    for name, state in saved["random"].items():
        device = env.device if name == "env" and env is not None else name  # others are named by their device
        check_random_state(state, device, f"{where}: random.{name}")


def check_fits(saved: Any, fresh: Any, where: str, most: int = 2**63 - 1) -> None:
    """Raise `RunError` unless a saved state fits the owner of a fresh state.

    Tensors must agree in shape and dtype, dictionaries in their keys, lists in their length; an empty fresh dictionary
    is one that fills up, and tells nothing of what may be in it; an empty fresh list fills with counts.

    ``fresh`` is as ``state_dict()`` gives it before any training; None in it is a count that is not known yet. No count
    may be above ``most``.
    """
    if not _same_kind(saved, fresh, most):
        raise RunError(f"{where}: expected {_told(fresh)}, found {_told(saved)}")
    if isinstance(fresh, Mapping):
        for key, inner in fresh.items():
            check_fits(saved[key], inner, f"{where}.{key}", most)
    elif isinstance(fresh, list | tuple):
        for index, inner in enumerate(fresh or [0] * len(saved)):
            check_fits(saved[index], inner, f"{where}[{index}]", most)


def _same_kind(saved: Any, fresh: Any, most: int) -> bool:
    if isinstance(fresh, Tensor):
        return isinstance(saved, Tensor) and (saved.shape, saved.dtype) == (fresh.shape, fresh.dtype)
    if isinstance(fresh, Mapping):
        return isinstance(saved, Mapping) and (not fresh or saved.keys() == fresh.keys())
    if isinstance(fresh, list | tuple):
        return isinstance(saved, list | tuple) and (not fresh or len(saved) == len(fresh))
    if fresh is None or type(fresh) is int:
        return (fresh is None and saved is None) or (type(saved) is int and 0 <= saved <= most)
    return type(saved) in (int, float) if isinstance(fresh, float) else type(saved) is type(fresh)


def _told(value: Any) -> str:
    if isinstance(value, Tensor):
        return f"{str(value.dtype).removeprefix('torch.')} {list(value.shape)}"
    if isinstance(value, Mapping):
        return f"{len(value)} entries ({', '.join(map(str, sorted(value, key=str)[:5]))})"
    if isinstance(value, list | tuple):
        return f"a list of {len(value)}"
    return "a count or nothing" if value is None else f"{type(value).__name__} {value!r}"[:80]


def check_optimiser(saved: Any, optimiser: Optimizer, where: str, trained: Any) -> None:
    """Raise `RunError` unless a fresh optimiser can take a saved ``state_dict()``: `check_fits`, and of each parameter.

    ``trained`` is how many parameters have a state; those without gradients so far have none.
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


def check_random_state(saved: Any, device: torch.device | str, where: str) -> None:
    """Raise `RunError` unless a tensor is the state of a random number generator of a device."""
    try:
        torch.Generator(device).set_state(saved)
    except (TypeError, RuntimeError) as error:
        raise RunError(f"{where}: is no state of a random number generator ({str(error).splitlines()[0]})") from None


def check_agents(saved: Any, env: EnvBase, where: str) -> None:
    """Raise `RunError` unless saved agents, tensors of the shapes of a ``reset``, are in the environment's specs."""
    for specs in (env.full_observation_spec, env.full_done_spec):
        for name, spec in specs.items():
            if not spec.is_in(saved[name]):
                raise RunError(f"{where}.{name}: holds values that the environment does not have")
