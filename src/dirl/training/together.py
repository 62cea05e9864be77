"""Jobs of a sweep: those that differ in numbers only are trained as one program, see `Stack`; the others in turn.

Every job has the run folder that it would have alone.
"""

import json
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig
from torch import Tensor
from tqdm import tqdm

from dirl.config.components import TARGET, class_parameters, find_class
from dirl.config.schemas import Device, Precision, TrainConfig, Until
from dirl.config.values import leaves, plain, typed
from dirl.evaluation.episodes import EvaluationProtocol, bar_interval
from dirl.runs.errors import interruptible, leave
from dirl.runs.folder import Run
from dirl.runs.paths import RunError
from dirl.scenes.io.bounded import read_text
from dirl.training.build import build_imitation_loss
from dirl.training.job import Components, Stages, build_components, conclude, facts_of, open_job, run_stages
from dirl.training.loops import DIVERGED, ImitationSteps, TrainState, Updates, due, write_evaluation
from dirl.training.objectives import FULL_BATCH, set_learning_rate, trained_parameters
from dirl.training.rollout import Update
from dirl.training.stacked import Stack, StackedOptimiser, walk_together

Learn = Callable[[TrainConfig, Any, Any], None]
"""`learn` of ``recipes/train.py``."""

VARIED = (
    "seed",
    "imitation.",
    "losses.",
    "optimiser.lr",
    "reward.",
    "reinforcement.gamma",
    "reinforcement.lmbda",
    "reinforcement.entropy_coef",
    "reinforcement.critic_coef",
    "logger.",
)
"""The options in which the runs of a stack may differ."""

READ_AT_ONCE = 10
"""Steps of the imitation between two looks at its losses, which wait for the GPU."""


@dataclass
class Job:
    """One job of a sweep."""

    composed: DictConfig
    folder: Path
    overrides: list[str]


def why_alone(run: Run, components: Components) -> str | None:
    """Return what keeps a run from being trained in a stack, in words; None if nothing does."""
    config, state, world = run.config, components.state, components.protocol.world
    if state is None:
        return "it learns nothing by reinforcement"
    options, imitation, losses = config.reinforcement, config.imitation, state.losses.losses.values()
    optimiser = find_class("optimiser", config.optimiser[TARGET], config.trust)
    reasons = {
        "several workers": options.workers > 1,
        "a memory": config.memory[TARGET] is not None,
        "views of earlier steps": config.observation[TARGET] != "dirl.envs.SurroundingViews",
        "until=stable": options.until != Until.frames,
        "several updates from a rollout": options.epochs * options.minibatches > 1,
        "rollouts longer than episodes": options.n_steps > options.max_steps,
        "precision=bfloat16": config.precision == Precision.bfloat16,
        "sampled demonstrations": imitation.sampled
        or imitation.batch_size is not None
        or len(components.demos) > FULL_BATCH,
        "DAgger": imitation.rounds > 0,
        "its imitation has begun": run.saved is not None and "imitation" in run.saved,
        "held-out goals": config.hold_out > 0,
        "noise on the views": imitation.noise > 0,
        "an environment of its own": config.env != {TARGET: "dirl.envs.NavigationEnv", "slip": 0.0},
        "an optimiser without capturable": config.device == Device.cuda
        and "capturable" not in class_parameters(optimiser),
        "a world that changes": world.looks > 1,
        "on a CPU several scenes, whose layers a stack applies to all rows": world.device.type == "cpu"
        and len(world.scenes) > 1,
        "a policy without features": not hasattr(components.policy, "features"),
        "a loss with weights of its own": len(state.parameters) > len(trained_parameters(components.policy)),
        "a loss that defines the reward": any(hasattr(loss.module, "reward") for loss in losses),
        "a loss that is not reduced by reduction": not all(hasattr(loss.module, "reduction") for loss in losses),
        "a loss that compares": any(loss.compares for loss in losses),
    }
    return next((reason for reason, holds in reasons.items() if holds), None)


def goes_together(run: Run, components: Components) -> bool:
    """True if a run alone on a GPU can be a stack of one; if not, the reason is told."""
    reason = why_alone(run, components)
    if reason is not None:
        print(f"no CUDA graph, each kernel is launched by itself: {reason}", file=sys.stderr, flush=True)
    return reason is None


def run_together(jobs: Sequence[Job], stages: Stages, learn: Learn) -> list[dict[str, Any] | Exception]:
    """Run the jobs of a sweep, as many of them as one program as can be.

    Args:
        jobs: of the sweep.
        stages: of one run, `train` of ``recipes/train.py``.
        learn: its loop of reinforcement.

    Returns:
        The summary of each, or the error that ended it; the others are run to their end.
    """
    results: list[Any] = [None] * len(jobs)
    kinds: dict[str, list[int]] = {}
    for number, job in enumerate(jobs):
        with _kept(results, number):
            config = typed(job.composed)
            fixed = {name: value for name, value in leaves(plain(config)).items() if not name.startswith(VARIED)}
            if config.goals is not None or config.evaluation.goals is not None:  # they may be drawn with the seed
                fixed["seed"] = config.seed
            kind = json.dumps([fixed, sorted(config.losses)], default=str, sort_keys=True)
            kinds.setdefault(kind, []).append(number)
    for numbers in kinds.values():
        stacks: dict[tuple[Any, ...], dict[int, tuple[Run, Components]]] = {}
        first: Components | None = None
        for number in numbers:
            with _kept(results, number):
                run, initial = open_job(jobs[number].composed, jobs[number].folder, jobs[number].overrides)
                if run.finished:
                    results[number] = json.loads(read_text(run.folder / "summary.json"))
                    continue
                components = build_components(run, initial, first)
                if (reason := why_alone(run, components)) is not None:
                    print(f"by itself: {run.folder}: {reason}", flush=True)
                    results[number] = run_stages(run, components, stages)
                    continue
                first = components
                # Runs that stand at the same frame, with the same losses and about as many demonstrations.
                at = 0 if run.saved is None else run.saved["frames"]
                alike = (at, *components.state.losses.losses, len(components.demos).bit_length())  # type: ignore[union-attr]
                stacks.setdefault(alike, {})[number] = (run, components)
        for members in stacks.values():
            try:
                found = _run_stack(list(members.values()), learn)
            except RunError as error:  # the imitation of one has diverged, which a stack has in common
                found = [error] * len(members)
            for number, result in zip(members, found, strict=True):
                results[number] = result
    for job, result in zip(jobs, results, strict=True):
        if isinstance(result, Exception):
            print(f"failed: {job.folder}: {result}", file=sys.stderr, flush=True)
    return results


@contextmanager
def _kept(results: list[Any], number: int) -> Iterator[None]:
    """Within this context an error is the result of a job, and does not end the others."""
    try:
        yield
    except Exception as error:
        results[number] = error


def _run_stack(members: Sequence[tuple[Run, Components]], learn: Learn) -> list[dict[str, Any] | Exception]:
    """Run those that stand at the same frame to their end; the summary of each, or why it has none."""
    print(f"{len(members)} runs as one: {', '.join(str(run.folder) for run, _ in members)}", flush=True)
    facts = []
    for run, components in members:
        run.begin(components.protocol.world, components.protocol.observation.order)
        facts.append(facts_of(run, components))
    results: list[Any] = []
    for (run, components), fact, (result, walked) in zip(members, facts, train_stack(members, learn), strict=True):
        if not isinstance(result, Exception):
            result = conclude(run, components.policy, walked, fact | result, shown=False)
        results.append(result)
    return results


def train_stack(
    members: Sequence[tuple[Run, Components]], learn: Learn
) -> list[tuple[dict[str, Any] | RunError, EvaluationProtocol]]:
    """Imitation and reinforcement of runs that differ in numbers only.

    Returns:
        What the summary of each says of them, or why it has none, and its protocol with all episodes.
    """
    runs = [run for run, _ in members]
    protocols = [components.protocol for _, components in members]
    states: list[TrainState] = [components.state for _, components in members]  # type: ignore[misc]
    world = protocols[0].world
    if world.device.type == "cpu":  # a generator each for its actions, which draws what torch's own would for it alone
        for run, state in zip(runs, states, strict=True):
            state.generator = torch.Generator().manual_seed(run.config.seed)
            if run.saved is not None:
                state.generator.set_state(run.saved["random"]["cpu"])
    demos: Any = [components.demos for _, components in members]
    stack = Stack([run.config for run in runs], states, demos, world, protocols[0].observation)
    if members[0][1].before_reinforcement:
        if stack.losses.demos is not None:
            imitate_together(stack, runs)
        if runs[0].config.evaluation.times:
            for run, state, walked in zip(runs, states, walk_together(stack, protocols), strict=True):
                write_evaluation(run, state.policy, walked, 0)
    with together(runs, stack, protocols) as loop:
        learn(stack.config, stack, loop)
    stack.separate()
    for number, finite in enumerate(stack.finite()):
        if not finite:
            loop.failed[number] = RunError(DIVERGED)
    walked_by_all = walk_together(stack, protocols, assess=True)
    return [
        (loop.failed.get(number) or state.summary, walked)
        for number, (state, walked) in enumerate(zip(states, walked_by_all, strict=True))
    ]


def train_alone(run: Run, components: Components, learn: Learn) -> dict[str, Any]:
    """Return the same of one run; what its summary says of it."""
    ((result, _),) = train_stack([(run, components)], learn)
    if isinstance(result, Exception):
        raise result
    return result


def imitate_together(stack: Stack, runs: Sequence[Run]) -> None:
    """Clone the experts of all runs, each until its actions are learned, as `imitate` of ``recipes/train.py`` does.

    A run that is done takes steps of the length zero until the last one is.
    """
    options, device = [run.config.imitation for run in runs], stack.device
    most = torch.tensor([option.max_steps for option in options], device=device)
    falls = torch.tensor([float(option.lr_decay) for option in options], device=device)
    threshold = torch.tensor([option.loss_threshold for option in options], device=device)
    weights = [state.policy.parameters() for state in stack.states]
    adam = [torch.optim.Adam(own, lr=option.lr, fused=True) for own, option in zip(weights, options, strict=True)]
    optimiser = StackedOptimiser(adam, stack.parameters, device)
    done = torch.zeros(len(runs), device=device)
    going = torch.ones(len(runs), dtype=torch.bool, device=device)
    loss_of_form = build_imitation_loss(runs[0].config, stack.form)
    loss_of_form.reduction = "none"
    trunk = stack.form.trunk()

    def of_run(rows: Any, shown: Tensor) -> tuple[Tensor, Tensor]:
        result = loss_of_form(trunk(rows.copy()))
        return tuple((result[key].flatten() * shown).sum() / shown.sum() for key in ("loss_imitation", "accuracy"))

    def step() -> Tensor:
        set_learning_rate(optimiser, optimiser.defaults["lr"] * (1 - falls * done / most) * going)
        loss, accuracy = stack.each(of_run, stack.losses.demos, stack.losses.shown)
        optimiser.zero_grad()
        loss.sum().backward()
        optimiser.step()
        done.add_(going)
        going.logical_and_((loss.detach() >= threshold) & (done < most))
        return torch.stack([loss.detach(), accuracy])

    update = stack.prepared(step)
    steps = [
        ImitationSteps(run, state.policy, own, 0, 0, saves=False)
        for run, state, own in zip(runs, stack.states, adam, strict=True)
    ]
    while any(own.goes_on for own in steps):
        behind = torch.stack([update().clone() for _ in range(READ_AT_ONCE)]).tolist()
        for losses, accuracies in behind:
            for own, loss, accuracy in zip(steps, losses, accuracies, strict=True):
                if own.goes_on:
                    own.record(loss, accuracy)
    for own in steps:
        print(f"{own.run.folder}: {own.step} steps of imitation: {own.accuracy:.1%} of the actions learned")


@dataclass
class StackedUpdates:
    """The updates of the reinforcement of a stack, as `Updates` are those of one run; made by `together`."""

    stack: Stack
    loops: list[Updates]
    protocols: list[EvaluationProtocol]
    bar: Any
    signals: list[int]
    began: float = field(default_factory=time.perf_counter)
    failed: dict[int, RunError] = field(default_factory=dict)
    """Runs whose policy has diverged, and what is to be told of it."""

    @property
    def goes_on(self) -> bool:
        """True if there are updates left to do."""
        return not self.loops[0].done and not self.signals and len(self.failed) < len(self.loops)

    @property
    def left(self) -> Tensor:
        """The fraction of the training that is left, 1 to 0, float64 ``[]`` on the device."""
        return self.stack.left

    def record(self, reports: Sequence[Update]) -> None:
        """Count an update of every run; write, evaluate and save all of them when it is due."""
        took = time.perf_counter() - self.began
        first = self.loops[0]
        before, after = first.state.frames, first.state.frames + reports[0].frames
        saves = any(loop.run.save_due() for loop in self.loops) or after >= first.total
        if saves:
            self.stack.separate()
        if due(before, after, first.total, first.run.config.evaluation.times):
            for loop, walked in zip(self.loops, walk_together(self.stack, self.protocols), strict=True):
                loop.protocol = walked
        for number, (loop, update) in enumerate(zip(self.loops, reports, strict=True)):
            if number in self.failed:
                continue
            if not all(math.isfinite(value) for key, value in update.values.items() if key.startswith("loss_")):
                self.failed[number] = RunError(DIVERGED)
                continue
            loop.state.began = time.perf_counter() - took
            loop.record(update, saves=saves)
        self.stack.left.fill_(first.left)
        self.bar.update(reports[0].frames * len(reports))
        self.began = time.perf_counter()


@contextmanager
def together(runs: Sequence[Run], stack: Stack, protocols: list[EvaluationProtocol]) -> Iterator[StackedUpdates]:
    """The updates of the reinforcement of a stack, from its present state on."""
    frames = runs[0].config.reinforcement.frames_per_scene * len(protocols[0].world.scenes)
    shown: dict[str, Any] = {"total": frames * len(runs), "initial": stack.states[0].frames * len(runs)}
    with interruptible() as signals, tqdm(**shown, unit=" frames", unit_scale=True, mininterval=bar_interval()) as bar:
        silent = tqdm(disable=True)
        loops = [
            Updates(run, state, protocol, frames, silent, signals)
            for run, state, protocol in zip(runs, stack.states, protocols, strict=True)
        ]
        stack.left.fill_(loops[0].left)
        yield StackedUpdates(stack, loops, protocols, bar, signals)
        if signals and not loops[0].done:
            stack.separate()
            for own in loops:
                own.run.save(own.state.state_dict())
            bar.close()
            same = f"existing=keep hydra.sweep.dir={runs[0].folder.parent}"
            advice = f"all checkpoints are safe; go on with the same command and {same}"
            leave("interrupted", 128 + signals[0], runs[0].how_to_go_on if len(runs) == 1 else lambda: advice)
