"""Jobs of a sweep: those that differ in numbers only are trained as one program, see `Stack`; the others in turn.

Every job has the run folder that it would have alone.
"""

import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig

from dirl.config.components import TARGET, class_parameters, find_class
from dirl.config.schemas import Device, Until
from dirl.config.values import leaves, plain, typed
from dirl.models.distinct import Cacheable
from dirl.runs.folder import Run
from dirl.runs.paths import Facts, RunError
from dirl.scenes.io.bounded import read_text
from dirl.training.build import describe
from dirl.training.job import DIVERGED, Components, Stages, build_components, conclude, open_job, run_stages
from dirl.training.loops import updates
from dirl.training.objectives import FULL_BATCH, trained_parameters
from dirl.training.stacked import Stack

Learn = Callable[..., None]
"""`learn` of ``recipes/train.py``."""

SWEPT = ("gamma", "lmbda", "entropy_coef", "critic_coef")
VARIED = (
    "seed",
    "imitation.",
    "losses.",
    "optimiser.lr",
    "reward.",
    "logger.",
    *(f"reinforcement.{name}" for name in SWEPT),
)
"""The options in which the runs of a stack may differ."""


@dataclass
class Job:
    """One job of a sweep."""

    composed: DictConfig
    folder: Path
    overrides: list[str]


def why_alone(run: Run, components: Components) -> str | None:
    """Return what keeps a run from being reinforced in a stack, in words; None if nothing does."""
    config, state, world = run.config, components.state, components.protocol.world
    if state is None:
        return "it learns nothing by reinforcement"
    options, imitation, losses = config.reinforcement, config.imitation, state.losses.losses.values()
    sampled = imitation.sampled or imitation.batch_size is not None or len(components.demos) > FULL_BATCH
    optimiser = class_parameters(find_class("optimiser", config.optimiser[TARGET], config.trust))
    reasons = {
        "several workers": options.workers > 1,
        "a memory": config.memory[TARGET] is not None,
        "views of earlier steps": config.observation[TARGET] != "dirl.envs.SurroundingViews",
        "until=stable": options.until != Until.frames,
        "several updates from a rollout": options.epochs * options.minibatches > 1,
        "rollouts longer than episodes": options.n_steps > options.max_steps,
        "sampled demonstrations": sampled,
        "held-out goals": config.hold_out > 0,
        "an environment of its own": config.env != {TARGET: "dirl.envs.NavigationEnv", "slip": 0.0},
        "an optimiser without capturable": config.device == Device.cuda and "capturable" not in optimiser,
        "a world that changes": world.looks > 1,
        # A stack applies the layers of every scene to all rows.
        "several scenes on a CPU": world.device.type == "cpu" and len(world.scenes) > 1,
        "an encoder without embed and fuse": not isinstance(getattr(components.policy, "encoder", None), Cacheable),
        "a loss with weights of its own": len(state.parameters) > len(trained_parameters(components.policy)),
        "a loss that defines the reward": any(hasattr(loss.module, "reward") for loss in losses),
        "a loss that is not reduced by reduction": not all(hasattr(loss.module, "reduction") for loss in losses),
        "a loss that compares": any(loss.compares for loss in losses),
    }
    return next((reason for reason, holds in reasons.items() if holds), None)


def run_together(jobs: Sequence[Job], train: Stages, imitation: Stages, learn: Learn) -> list[Facts | Exception]:
    """Run the jobs of a sweep, as many of them as one program as can be.

    Args:
        jobs: of the sweep.
        train: the stages of one run, of ``recipes/train.py``.
        imitation: those before its reinforcement.
        learn: its loop of reinforcement.

    Returns:
        The summary of each, or the error that ended it; the others are run to their end.
    """
    results: list[Any] = [None] * len(jobs)
    stacks: dict[str, dict[int, tuple[Run, Components]]] = {}
    for number, job in enumerate(jobs):
        try:
            config = typed(job.composed)
            fixed = {name: value for name, value in leaves(plain(config)).items() if not name.startswith(VARIED)}
            if config.goals is not None or config.evaluation.goals is not None:  # they may be drawn with the seed
                fixed["seed"] = config.seed
            run, initial = open_job(job.composed, job.folder, job.overrides)
            if run.finished:
                results[number] = json.loads(read_text(run.folder / "summary.json"))
                continue
            kind = json.dumps(fixed, default=str, sort_keys=True)
            like = next((stack for other, stack in stacks.items() if other.startswith(kind)), None)
            components = build_components(run, initial, None if like is None else next(iter(like.values()))[1])
            if (reason := why_alone(run, components)) is not None:
                print(f"by itself: {run.folder}: {reason}", flush=True)
                run.begin(components.protocol.world, components.protocol.observation.order)
                results[number] = run_stages(run, components, train)
                continue
            # Runs that stand at the same frame, with the same losses and about as many demonstrations.
            at = 0 if run.saved is None else run.saved["frames"]
            losses = sorted(components.state.losses.losses)  # type: ignore[union-attr]
            alike = f"{kind} {at} {losses} {len(components.demos).bit_length()}"
            stacks.setdefault(alike, {})[number] = (run, components)
        except Exception as error:
            results[number] = error
    for members in stacks.values():
        for number, result in run_stack(members, imitation, learn):
            results[number] = result
    for job, result in zip(jobs, results, strict=True):
        if isinstance(result, Exception):
            print(f"failed: {job.folder}: {result}", file=sys.stderr, flush=True)
    return results


def run_stack(
    members: Mapping[int, tuple[Run, Components]], imitation: Stages, learn: Learn
) -> Iterator[tuple[int, Facts | Exception]]:
    """Train runs that stand at the same frame, their reinforcement as one; yields the summary of each, or its error."""
    print(f"{len(members)} runs as one: {', '.join(str(run.folder) for run, _ in members.values())}", flush=True)
    ready = {}
    for number, (run, components) in members.items():
        try:
            run.begin(components.protocol.world, components.protocol.observation.order)
            if run.saved is None:
                torch.manual_seed(run.config.seed)
            imitation(run, components)
            # A generator of its own for the actions, which draws what torch's own would for this run alone.
            assert components.state is not None
            goes_on = None if components.before_reinforcement else run.saved
            components.state.generator = torch.Generator()
            components.state.generator.set_state(goes_on["random"]["cpu"] if goes_on else torch.get_rng_state())
            ready[number] = (run, components)
        except Exception as error:
            yield number, error
    if not ready:
        return
    stack = reinforce_together(list(ready.values()), learn)
    protocols = stack.walked([components.protocol for _, components in ready.values()], assess=True)
    walked = zip(ready.items(), stack.members, stack.finite(), protocols, strict=True)
    for (number, (run, components)), state, finite, protocol in walked:
        facts = describe(run.config, protocol.world) | {"demonstrations": len(components.demos)} | state.summary
        yield number, conclude(run, state.policy, protocol, facts, shown=False) if finite else RunError(DIVERGED)


def reinforce_together(members: Sequence[tuple[Run, Components]], learn: Learn) -> Stack:
    """Reinforce runs that differ in numbers only; returns their stack."""
    runs, every = zip(*members, strict=True)
    states, demos, protocols = ([getattr(one, name) for one in every] for name in ("state", "demos", "protocol"))
    stack = Stack([run.config for run in runs], states, demos, protocols[0].world, protocols[0].observation)
    with updates(stack, runs, protocols) as loop:
        learn(stack.config, stack, loop, stack.prepared)
    return stack


def reinforce_captured(run: Run, components: Components, learn: Learn) -> Facts | None:
    """Reinforce one run as a stack, whose update is a CUDA graph; returns what the summary says of it.

    Returns None, and tells why, if it cannot be one.
    """
    if (reason := why_alone(run, components)) is not None:
        print(f"no CUDA graph, each kernel is launched by itself: {reason}", file=sys.stderr, flush=True)
        return None
    if not all(reinforce_together([(run, components)], learn).finite()):
        raise RunError(DIVERGED)
    assert components.state is not None
    return components.state.summary
