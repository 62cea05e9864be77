"""What the loops of ``recipes/train.py`` leave out: state, progress, interrupts, metrics, checkpoints, evaluation.

A loop is used within its context, whose end stops the program if a signal came meanwhile:

    with updates(state, [run], [protocol]) as loop:
        while loop.goes_on:
            ...  # collect, losses, backward, clip, step
            loop.record(report)
"""

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from typing import Any, ClassVar

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn
from torch.optim import Optimizer
from torchrl.envs import EnvBase
from tqdm import tqdm

from dirl.config.schemas import TrainConfig, Until
from dirl.evaluation.episodes import BAR_SECONDS
from dirl.evaluation.experts import label
from dirl.evaluation.protocol import EpisodeMeter, EvaluationProtocol, metrics
from dirl.models import ActorCritic, plain_weights
from dirl.models.distinct import reading_waits
from dirl.runs.checkpoints import Facts, RunError, State, restoring
from dirl.runs.exits import interruptible, leave
from dirl.runs.folder import Run
from dirl.training.build import build_env, build_expert
from dirl.training.objectives import Losses
from dirl.training.pairs import Demonstrations, with_labels
from dirl.training.rollout import Report, collect

ROWS = 200
"""Rows of reinforcement.csv, evenly spread over the training."""


@dataclass
class TrainState:
    """Everything that changes between updates."""

    config: TrainConfig
    policy: ActorCritic
    """See `dirl.models.ActorCritic`."""
    losses: Losses
    parameters: list[nn.Parameter]
    """What is trained: the policy's parameters and the losses' own."""
    optimiser: Optimizer
    env: EnvBase
    agents: TensorDictBase
    """Where the agents stand, ``[B]``; replaced in place, as a CUDA graph needs it."""
    meter: EpisodeMeter
    frames: int = 0
    seconds: float = 0.0
    """Spent on updates, without evaluation."""
    left: Tensor = field(default_factory=lambda: torch.ones((), dtype=torch.float64))
    """The fraction of the training that is left, 1 to 0, float64 ``[]``; also replaced in place."""
    generator: torch.Generator | None = None
    """In a stack that of the run's actions; else they are drawn by torch's own."""
    random: Tensor | None = None
    """The state of what draws the actions, in a training that goes on."""

    stacked: ClassVar[bool] = False
    """True if the first dimension of everything is the run, see `dirl.training.stacked.Stack`."""

    @property
    def summary(self) -> Facts:
        """What the summary of a run says of its reinforcement."""
        speed = self.frames / self.seconds
        return {"frames": self.frames, "frames_per_second": speed, "stable_at_frame": self.meter.stable_at}

    def state_dict(self) -> State:
        """Return what `load_state_dict` takes, and under ``network`` the weights for everyone else."""
        # Of the losses what is not the policy's: weights, buffers, extra state.
        of_policy = {value.data_ptr() for value in (*self.policy.parameters(), *self.policy.buffers()) if value.numel()}
        own_of_losses = {
            name: value
            for name, value in self.losses.state_dict().items()
            if not (isinstance(value, Tensor) and value.data_ptr() in of_policy)
        }
        random = {"env": self.env.base_env.generator.get_state(), **random_state(self.env.device)}
        if self.generator is not None:
            random["cpu"] = self.generator.get_state()
        return {
            "frames": self.frames,
            "training_seconds": self.seconds,
            "network": plain_weights(self.policy),
            "learning": self.policy.state_dict(),
            "losses": own_of_losses,
            "optimiser": self.optimiser.state_dict(),
            "agents": self.agents.cpu().to_dict(),
            "meter": self.meter.state_dict(),
            "random": random,
        }

    def load_state_dict(self, state: State) -> None:
        """Restore a saved state."""
        self.frames, self.seconds = state["frames"], state["training_seconds"]
        self.policy.load_state_dict(state["learning"])
        self.losses.load_state_dict({**self.losses.state_dict(), **state["losses"]})
        self.optimiser.load_state_dict(state["optimiser"])
        agents = TensorDict(state["agents"], batch_size=self.env.batch_size, device=self.env.device)
        self.agents = self.env.base_env.restore_agents(agents)
        self.meter.load_state_dict(state["meter"])
        self.env.base_env.generator.set_state(state["random"]["env"])
        self.random = state["random"]["cpu"]
        restore_random_state(state["random"])


def random_state(device: torch.device) -> dict[str, Tensor]:
    """Return the state of torch's own generators, from which actions and pairs are sampled."""
    own = {} if device.type == "cpu" else {device.type: torch.get_device_module(device).get_rng_state()}
    return {"cpu": torch.get_rng_state(), **own}


def restore_random_state(state: Mapping[str, Tensor]) -> None:
    """Restore the generators' states that `random_state` returned."""
    torch.set_rng_state(state["cpu"])
    for device in state.keys() - {"cpu", "env"}:
        torch.get_device_module(device).set_rng_state(state[device])


@dataclass
class Imitation:
    """The steps of a run's imitation, and what changes from one to the next."""

    run: Run
    policy: ActorCritic
    """Its encoder and policy head are trained; the value head learns nothing."""
    optimiser: Optimizer
    first: int
    """Steps before this imitation."""
    step: int
    loss: float = math.inf
    """Of the latest step, as is the accuracy: the fraction of its rows in which the most probable action is right."""
    accuracy: float = 0.0

    @property
    def goes_on(self) -> bool:
        """True if there are steps left to do."""
        options = self.run.config.imitation
        return self.step - self.first < options.max_steps and self.loss >= options.loss_threshold

    def state_dict(self) -> State:
        """Return what `load_state_dict` takes, and under ``network`` the weights for everyone else."""
        return {
            "frames": 0,
            "imitation": {"step": self.step, "loss": self.loss, "accuracy": self.accuracy},
            "network": plain_weights(self.policy),
            "learning": self.policy.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "random": random_state(next(self.policy.parameters()).device),
        }

    def load_state_dict(self, state: State) -> None:
        """Go on from a saved state."""
        self.step, self.loss, self.accuracy = (state["imitation"][name] for name in ("step", "loss", "accuracy"))
        self.policy.load_state_dict(state["learning"])
        self.optimiser.load_state_dict(state["optimiser"])
        restore_random_state(state["random"])


@dataclass
class ImitationSteps:
    """The steps of an imitation, of one run or of those of a stack; made by `imitation_steps`."""

    members: Sequence[Imitation]
    optimiser: Any
    """Of the run, or of all."""
    bar: tqdm
    signals: list[int]
    """Signals that ask the loop to end."""

    @property
    def goes_on(self) -> bool:
        """True if any run has steps left to do."""
        return any(member.goes_on for member in self.members) and not self.signals

    @property
    def lr(self) -> Tensor:
        """The learning rates of the next step, of each run: constant, or with ``imitation.lr_decay`` linearly to zero.

        Of a run that is done it is 0.
        """
        rates = []
        for member in self.members:
            options = member.run.config.imitation
            done = (member.step - member.first) / options.max_steps if options.lr_decay else 0
            rates.append(options.lr * (1 - done) if member.goes_on else 0.0)
        return torch.tensor(rates, dtype=torch.float64)

    def record(self, step: Tensor) -> None:
        """Count a step of loss and accuracy ``[2]``, or ``[2, R]``; write its metrics, save when it is time to.

        Raises:
            RunError: the loss of the only run is not finite. The checkpoints before are not touched.
        """
        for member, own in zip(self.members, step.view(2, -1).T.tolist(), strict=True):
            if len(self.members) == 1 and not math.isfinite(own[0]):
                at = f"a loss of {own[0]} at step {member.step}"
                raise RunError(f"the imitation has diverged: {at}; lower imitation.lr")
            if member.goes_on:
                member.loss, member.accuracy = own
                member.step += 1
                row = {"step": member.step, "loss": member.loss, "accuracy": member.accuracy}
                member.run.write("imitation", member.step, row)
        self.bar.update()
        saves = any(own.run.save_due(len(self.members)) for own in self.members)
        if not self.members[0].first and (saves or self.signals):
            for member in self.members:
                member.run.save(member.state_dict())


@contextmanager
def imitation_steps(
    runs: Sequence[Run], policy: Any, demos: Sequence[Demonstrations], first: int
) -> Iterator[ImitationSteps]:
    """Run the steps of an imitation from step ``first``; those after step 0 are rounds of DAgger, not saved.

    The policy is that of one run, or a `dirl.training.stacked.Stack`.
    """
    stacked, members = getattr(policy, "stacked", False), list[Imitation]()
    for run, own in zip(runs, policy.policies if stacked else [policy], strict=True):
        fused = reading_waits(next(own.parameters()))  # as a graph of one kernel for all weights
        optimiser: Any = torch.optim.Adam(own.parameters(), lr=run.config.imitation.lr, fused=fused)
        members.append(Imitation(run, own, optimiser, first, first))
        if run.saved is not None and "imitation" in run.saved and not first:
            with restoring(run.folder):
                members[-1].load_state_dict(run.saved)
    options = runs[0].config.imitation
    done, hidden = members[0].step - first, not options.sampled
    bar = tqdm(total=options.max_steps, initial=done, unit=" steps", mininterval=BAR_SECONDS, disable=hidden)
    optimiser = policy.joined([own.optimiser for own in members], apart=True) if stacked else members[0].optimiser
    with interruptible() as signals, bar:
        yield ImitationSteps(members, optimiser, bar, signals)
    if signals:
        leave("interrupted", 128 + signals[0], lambda: how_to_go_on(runs))
    learned = f"{sum(own.accuracy for own in members) / len(members):.1%} of the actions learned"
    steps = max(own.step for own in members)
    print(f"{sum(map(len, demos))} demonstrations, {steps} steps of imitation: {learned}")


@dataclass
class Updates:
    """The updates of a reinforcement, of one run or of those of a stack; made by `updates`."""

    state: Any
    """A `TrainState`, or a `dirl.training.stacked.Stack`."""
    members: Sequence[TrainState]
    """The states of the runs: the same, or those in the stack."""
    runs: Sequence[Run]
    protocols: Sequence[EvaluationProtocol]
    total: int
    """Frames of the whole training of a run."""
    frames: int
    """Of a run, so far."""
    bar: tqdm
    signals: list[int]
    """Signals that ask the loop to end."""
    unread: list[tuple[Report, int, Any]] = field(default_factory=list)
    """Reports that are on their way from a GPU, up to which frame each tells, and when it will be here."""
    began: float = field(default_factory=time.perf_counter)
    """When the present update began."""

    @property
    def goes_on(self) -> bool:
        """True if there are updates left to do."""
        return not self.done and not self.signals

    @property
    def done(self) -> bool:
        """True if all frames are done, or with ``until=stable`` every goal is stable and was evaluated since."""
        config, first = self.runs[0].config, self.members[0]
        stable = first.meter.stable_at if config.reinforcement.until == Until.stable else None
        return self.frames >= self.total or (
            stable is not None and due(stable, self.frames, self.total, config.evaluation.times)
        )

    def record(self, report: Report, paused: AbstractContextManager[None] | None = None) -> None:
        """Count an update of every run; write, evaluate and save when it is due, the latter two within ``paused``.

        From a GPU the report of a stack is read during the next update, which has been launched by then.
        """
        config, before = self.runs[0].config, self.frames
        self.frames += report.frames
        numbers, arrived = report.numbers, None
        if self.state.stacked and numbers.is_cuda:
            numbers, arrived = numbers.to("cpu", non_blocking=True), torch.cuda.Event()
            arrived.record()
        self.unread.append((report._replace(numbers=numbers), self.frames, arrived))
        evaluates = due(before, self.frames, self.total, config.evaluation.times)
        self._read(1 if arrived is not None and not evaluates and not self.done else 0)
        # The end of many runs comes right after: their checkpoints would take longer than what they save.
        saves = (self.done and len(self.runs) == 1) or any(run.save_due(len(self.runs)) for run in self.runs)
        if evaluates or saves:
            self._read()
            with paused or nullcontext():
                if evaluates:
                    write_evaluations(self.runs, self.state.policy, self.protocols, self.frames)
                if saves:
                    for run, state in zip(self.runs, self.members, strict=True):
                        run.save(state.state_dict())
            self.began = time.perf_counter()
        self.state.left.fill_(1 - self.frames / self.total)
        # tqdm drops a bar that is more than full.
        self.bar.update(min(report.frames * len(self.runs), self.bar.total - self.bar.n))

    def _read(self, later: int = 0) -> None:
        """Read the reports, but for so many; count their updates, and write rows."""
        config = self.runs[0].config
        while len(self.unread) > later:
            report, frames, arrived = self.unread.pop(0)
            if arrived is not None:
                arrived.synchronize()
            reports, now = report.read(), time.perf_counter()
            for run, state, own in zip(self.runs, self.members, reports, strict=True):
                before, meter = state.frames, state.meter
                state.seconds += now - self.began
                state.frames += own.frames
                meter.add(own.goal_index, own.steps, state.frames)
                if due(before, frames, self.total, ROWS):
                    rate = state.optimiser.defaults["lr"] * (1 - before / self.total)
                    row = {"frames": frames, "seconds": state.seconds, "frames_per_second": frames / state.seconds}
                    row |= {**meter.measures(config.reinforcement.max_steps), "lr": rate}
                    self.bar.set_postfix_str(f"ATL {row['atl']:.1f}", refresh=False)
                    run.write("reinforcement", frames, row | own.values)
            self.began = now


@contextmanager
def updates(state: Any, runs: Sequence[Run], protocols: Sequence[EvaluationProtocol]) -> Iterator[Updates]:
    """Run the updates of a reinforcement from its present state on, of one run or of a stack; see `Updates`."""
    members = state.members if state.stacked else [state]
    total = runs[0].config.reinforcement.frames_per_scene * len(protocols[0].world.scenes)
    frames = members[0].frames
    bar = tqdm(
        total=total * len(runs), initial=frames * len(runs), unit=" frames", unit_scale=True, mininterval=BAR_SECONDS
    )
    state.left.fill_(1 - frames / total)
    with interruptible() as signals, bar:
        loop = Updates(state, members, runs, protocols, total, frames, bar, signals)
        yield loop
        if signals and not loop.done:
            for run, member in zip(runs, members, strict=True):
                run.save(member.state_dict())
            bar.close()
            leave("interrupted", 128 + signals[0], lambda: how_to_go_on(runs))


def how_to_go_on(runs: Sequence[Run]) -> str:
    """Return what is safe of a run, or of those of a stack, and how to continue."""
    again = f"go on with the same command and existing=keep hydra.sweep.dir={runs[0].folder.parent}"
    return runs[0].how_to_go_on() if len(runs) == 1 else f"all checkpoints are safe; {again}"


def dagger_rounds(run: Run, parts: Any, demos: Demonstrations) -> Iterator[tuple[Demonstrations, int]]:
    """Run the rounds of DAgger: the learner walks, the expert labels the states it came to, all is cloned again.

    After each round a row of ``dagger.csv`` is written: frames walked so far, states and goals labelled so far, and the
    metrics of the clone.

    Yields:
        The demonstrations and the frames walked so far.
    """
    options, policy, protocol = run.config.imitation, parts.policy, parts.protocol
    if options.rounds == 0:
        return
    env, operator = build_env(run.config, parts.world, protocol.observation, policy), policy.operator()
    expert = build_expert(run.config, parts.world)
    agents, frames = env.reset(), 0
    for number in range(1, options.rounds + 1):
        batch, agents = collect(env, operator, agents, options.walk_steps)
        frames += batch.numel()
        demos = with_labels(demos, label(expert, batch.reshape(-1)))
        yield demos, frames
        row = {"round": number, "frames": frames, "labels": len(demos)}
        run.write("dagger", number, row | metrics(protocol.run(policy)))


def due(before: int, now: int, total: int, times: int) -> bool:
    """Return True if one of ``times`` moments, evenly spread over ``total`` frames, is between two counts of frames."""
    return before * times // total < now * times // total


def write_evaluations(runs: Sequence[Run], policy: Any, protocols: Sequence[EvaluationProtocol], frames: int) -> None:
    """Evaluate the policy of each run as it is, greedily, and write a row of ``evaluation.csv``.

    The policy is that of one run, or a `dirl.training.stacked.Stack`, whose episodes are walked together.
    """
    policies = [policy]
    if getattr(policy, "stacked", False):
        protocols, policies = policy.walked(protocols), policy.policies
    for run, own, protocol in zip(runs, policies, protocols, strict=True):
        row = {"frames": frames, **metrics(protocol.run(own))}
        if protocol.live is not None:
            live = metrics(protocol.live(own))
            row |= {f"live_{key}": live[key] for key in ("sr", "spl")}
        if protocol.held_out is not None:
            held_out = metrics(protocol.held_out.run(own))
            row |= {f"held_out_{key}": held_out[key] for key in ("sr", "spl")}
        run.write("evaluation", frames, row)
