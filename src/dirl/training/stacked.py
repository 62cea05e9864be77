"""Several trainings as one: weights ``[R, ...]``, agents ``[R, B]``, on a GPU one CUDA graph an update.

Jobs of a sweep that differ in numbers only become a `Stack`; the others are trained in turn. Every job has the run
folder that it would have alone. To `learn` of ``recipes/train.py`` a `Stack` is what the `TrainState` of one training
is; everything in it has the run as its first dimension. Each run keeps its own `TrainState`, whose weights are views of
the stacked ones: it is evaluated, saved and resumed as if it had been trained alone.
"""

import copy
import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from operator import attrgetter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import torch
from omegaconf import DictConfig
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torch.distributions import Categorical
from torch.func import vmap

from dirl.agent.decisions import observe
from dirl.config.components import TARGET, class_parameters, find_class
from dirl.config.files import leaves
from dirl.config.schemas import Device, Schedule, TrainConfig, Until
from dirl.evaluation.episodes import EvaluationProtocol
from dirl.models.distinct import Cacheable, reading_waits
from dirl.models.policy import VIEW_IDS, in_scene
from dirl.runs.checkpoints import Facts, is_finished
from dirl.runs.folder import Run
from dirl.scenes.io.files import read_text
from dirl.training.build import build_env, build_imitation_loss, build_losses, check_device, describe
from dirl.training.job import Components, Stages, build_components, conclude, open_job, run_stages
from dirl.training.loops import TrainState, updates
from dirl.training.objectives import FULL_BATCH, Losses, trained_parameters

VARIED = (
    *("seed", "imitation.", "losses.", "optimiser.lr", "reward.", "logger."),
    *(f"reinforcement.{name}" for name in ("gamma", "lmbda", "entropy_coef", "critic_coef")),
)
"""The options in which the runs of a stack may differ."""


@dataclass
class Job:
    """One job of a sweep."""

    composed: DictConfig
    folder: Path
    overrides: list[str]


def why_alone(config: TrainConfig, components: Components) -> str | None:
    """Return what keeps a run from being trained in a stack, in words; None if nothing does."""
    state, world = components.state, components.world
    if state is None:
        return "it learns nothing by reinforcement"
    options, imitation, losses = config.reinforcement, config.imitation, state.losses.losses.values()
    modules = [*(loss.module for loss in losses), build_imitation_loss(config, components.policy)]
    optimiser = class_parameters(find_class("optimiser", config.optimiser[TARGET], config.trust))
    reasons: dict[str, Any] = {
        "several workers": options.workers > 1,
        "a memory": config.memory[TARGET] is not None,
        "views of earlier steps": config.observation[TARGET] != "dirl.envs.SurroundingViews",
        "until=stable": options.until != Until.frames,
        "several updates from a rollout": options.epochs * options.minibatches > 1,
        "sampled demonstrations": imitation.sampled or imitation.batch_size or len(components.demos) > FULL_BATCH,
        "rounds of DAgger, or noise": imitation.rounds > 0 or imitation.noise > 0,
        "held-out goals": config.hold_out > 0,
        "an environment of its own": config.env != {TARGET: "dirl.envs.NavigationEnv", "slip": 0.0},
        "an optimiser without capturable": config.device == Device.cuda and "capturable" not in optimiser,
        "a world that changes": world.looks > 1,
        "many goals": len(world.distances) > FULL_BATCH,  # whose every pair with a state is answered
        # A stack applies the layers of every scene to all rows.
        "several scenes on a CPU": world.device.type == "cpu" and len(world.scenes) > 1,
        "an encoder without embed and fuse": not isinstance(getattr(components.policy, "encoder", None), Cacheable),
        "a loss with weights of its own": len(state.parameters) > len(trained_parameters(components.policy)),
        "a loss that defines the reward": any(hasattr(loss.module, "reward") for loss in losses),
        "a loss that compares": any(loss.compares for loss in losses),
        "a loss that is no mean by reduction": any(getattr(module, "reduction", None) != "mean" for module in modules),
    }
    return next((reason for reason, holds in reasons.items() if holds), None)


def run_together(
    jobs: Sequence[Job], train: Stages, imitation: Callable[..., Any], learn: Callable[..., Any]
) -> list[Facts | Exception]:
    """Run the jobs of a sweep, as many of them as one program as can be, by functions of ``recipes/train.py``.

    Returns:
        The summary of each, or the error that ended it; the others are run to their end.
    """
    results: dict[int, Facts | Exception] = {}
    stacks: dict[tuple[Any, ...], dict[int, tuple[Run, Components]]] = {}
    of_kind: dict[str, Components] = {}
    for device in {job.composed.device for job in jobs}:  # an error of every job is told once, before all work
        check_device(device)
    for number, job in enumerate(jobs):
        try:
            run, initial = open_job(job.composed, job.folder, job.overrides)
            if is_finished(run.folder):
                results[number] = json.loads(read_text(run.folder / "summary.json"))
                continue
            fixed = {name: value for name, value in leaves(asdict(run.config)).items() if not name.startswith(VARIED)}
            if run.config.goals is not None or run.config.evaluation.goals is not None:  # they may be drawn with it
                fixed["seed"] = run.config.seed
            kind = json.dumps(fixed, default=str, sort_keys=True)
            components = build_components(run, initial, of_kind.get(kind))
            run.begin(components.world, components.protocol.observation.order)
            if (reason := why_alone(run.config, components)) is not None:
                print(f"by itself: {run.folder}: {reason}", flush=True)
                results[number] = run_stages(run, components, train)
                continue
            of_kind.setdefault(kind, components)
            # Runs that stand at the same frame, with the same losses and about as many demonstrations.
            state: Any = components.state
            alike = (kind, state.frames, *sorted(state.losses.losses), len(components.demos).bit_length())
            stacks.setdefault(alike, {})[number] = (run, components)
        except Exception as error:
            results[number] = error
    for members in stacks.values():
        results.update(run_stack(members, imitation, learn))
    for number, job in enumerate(jobs):
        if isinstance(results[number], Exception):
            print(f"failed: {job.folder}: {results[number]}", file=sys.stderr, flush=True)
    return [results[number] for number in range(len(jobs))]


def run_stack(
    members: Mapping[int, tuple[Run, Components]], imitation: Callable[..., Any], learn: Callable[..., Any]
) -> Iterator[tuple[int, Facts | Exception]]:
    """Train runs that stand at the same frame as one; yields the summary of each, or its error."""
    print(f"{len(members)} runs as one: {', '.join(str(run.folder) for run, _ in members.values())}", flush=True)
    runs, every = zip(*members.values(), strict=True)
    protocols = [components.protocol for components in every]
    stack = Stack(every)
    imitation(runs, every, stack)
    with updates(stack, runs, protocols) as loop:
        learn(stack, loop)
    walked = stack.walked(protocols, assess=True)
    for number, run, components, protocol in zip(members, runs, every, walked, strict=True):
        facts = describe(run.config, protocol.world) | {"demonstrations": len(components.demos)}
        try:
            yield number, conclude(run, components.policy, protocol, facts | components.state.summary, shown=False)
        except Exception as error:
            yield number, error


def captured(run: Run, components: Components) -> "TrainState | Stack | None":
    """Return a run's state as a stack of one, whose update is a CUDA graph; or tell why it is none, and return it."""
    reason = why_alone(run.config, components)
    if reason is None:
        return Stack([components])
    print(f"no CUDA graph, each kernel is launched by itself: {reason}", file=sys.stderr, flush=True)
    return components.state


class Stack:
    """R trainings that differ in numbers and demonstrations only, see `why_alone`; world and observation are shared."""

    stacked = True

    def __init__(self, every: Sequence[Components]) -> None:
        self.members: list[Any] = [components.state for components in every]
        """Their states, `TrainState`."""
        first, demos = self.members[0], [components.demos for components in every]
        self.world, observation = every[0].world, every[0].protocol.observation
        self.device = first.env.device
        self.config = with_tensors([state.config for state in self.members], self.device)
        # What is asked of a policy, `operator` and ``cached`` (`dirl.models.caching`), the stack has for all runs.
        self.policy = self.cached = self
        # One policy with its losses is the form that the weights of every run are put into. Its features are shared.
        self.form: Any = copy.deepcopy(first.policy, {id(first.policy.features): first.policy.features})
        del self.form.cached  # which may be a module; in its place comes a function
        self.form.cached = self._fused
        for module in self.form.modules():
            if type(module) is nn.Linear and module.bias is not None:  # in its place vmap would add a product with 1
                module.forward = lambda rows, own=module: rows @ own.weight.mT + own.bias  # type: ignore
        self.views = observation.reset_view_ids(torch.arange(len(self.world), device=self.device))
        self.goal_views, self.goal_index = observation.goal_view_ids(self.world.goals), self.world.goal_index
        goals, states = self.world.pairs()
        asked = observe(self.world, observation, states, self.views[states], goals)
        sizes = asked["scene"].unique_consecutive(return_counts=True)[1].tolist()
        self.asked = [(int(part["scene"][0]), part) for part in asked.split(sizes)]
        """Every pair of goal and state, ``[P]``, by their scene."""
        # In `keeping`: embeddings of all runs, those of the run that is computed, and answers to the pairs.
        self._kept, self._own = tuple[Tensor, ...](), tuple[Tensor, ...]()
        self._answers: Any = None
        self.policies = [state.policy for state in self.members]
        self.weights = stacked_weights(self.policies)
        self.parameters = list(self.weights.values(True, True))
        self.optimiser = self.joined([state.optimiser for state in self.members])
        self.agents: TensorDictBase = torch.stack([state.agents for state in self.members])
        for state, agents in zip(self.members, self.agents.unbind(0), strict=True):
            state.agents = agents  # as are its weights a view, which changes with the stack
            # What draws its actions: the same as torch's own would draw for it alone.
            state.generator = torch.Generator().manual_seed(state.config.seed)
            if state.random is not None:
                state.generator.set_state(state.random)
        # On a CPU each run draws what it would alone; on a GPU one kernel draws for all.
        drawn = [state.env.base_env.generator for state in self.members]
        self.generators: list[torch.Generator] = [state.generator for state in self.members]
        if self.device.type != "cpu":
            self.generators = drawn = drawn[:1]
        self.env = build_env(self.config, self.world, observation, self.form, agents=self.agents.shape)
        self.env.base_env.generators = drawn
        self.left = torch.ones((), dtype=torch.float64, device=self.device)
        # Of its graphs: not the default one, with which a capture must share nothing.
        self.stream = torch.cuda.Stream() if reading_waits(self.left) else None
        self.losses = StackedLosses(self, build_losses(first.config, self.form, self.world, demos[0]), demos)

    def joined(self, optimisers: Sequence[Any], *, apart: bool = False) -> Any:
        """Return the optimisers of the runs as one, with their state.

        It has a group, which one kernel steps, for each learning rate, or if they are to be ``apart`` for each run.
        """
        alike: dict[Any, list[Any]] = {}
        for number, own in enumerate(optimisers):
            alike.setdefault(number if apart else own.defaults["lr"], []).append(own)
        rates = torch.tensor([some[0].defaults["lr"] for some in alike.values()], dtype=torch.float64).to(self.device)
        first, groups = optimisers[0], []
        for some, rate in zip(alike.values(), rates.float(), strict=True):
            weights = [value for own in some for value in own.param_groups[0]["params"]]
            group = first.param_groups[0] | {"params": weights}
            # In a graph the rate is read from its place in the memory. Not every optimiser can on a CPU.
            if self.device.type != "cpu" or group.get("fused"):
                group |= {"lr": rate, "capturable": True}
            groups.append(group)
        state = {value: own.state[value] for own in optimisers for value in own.param_groups[0]["params"]}
        result = object.__new__(type(first))
        vars(result).update(vars(first), param_groups=groups, state=state, defaults=first.defaults | {"lr": rates})
        result._warned_capturable_if_run_uncaptured = True  # it is uncaptured before the capture
        # In place: a graph adds to the same memory at every replay.
        result.zero_grad = partial(torch._foreach_zero_, [weight.grad for weight in self.parameters])
        return result

    def cloning(self) -> Callable[[], TensorDictBase]:
        """Return what compares each run with the expert on its demonstrations: loss and accuracy, ``[R]``."""
        loss: Any = build_imitation_loss(self.config, self.form)
        trunk, loss.reduction = self.form.trunk(), "none"

        def of_run(rows: TensorDictBase, counts: Tensor) -> TensorDict:
            losses = loss(trunk(rows.copy()))
            return TensorDict({key: mean(losses[key], counts) for key in ("loss_imitation", "accuracy")})

        return lambda: self.each(of_run, *self.losses.demonstrated)

    def operator(self) -> "Stack":
        """Return what takes the agents ``[R, B]`` through the policies of their runs."""
        return self

    def get_value_operator(self) -> TensorDictModule:
        """Return the same for values alone."""
        return TensorDictModule(lambda *view_ids: self._found(*view_ids)["state_value"], [*VIEW_IDS], ["state_value"])

    def __call__(self, agents: TensorDictBase) -> TensorDictBase:
        """Return the agents with action, its log-probability and the state's value, each run by its own policy."""
        written = agents.copy().update(self._found(*(agents[key] for key in VIEW_IDS)))
        choice = Categorical(logits=written["logits"], validate_args=False)
        # What torch.multinomial does where one number is drawn, by the generators of the runs.
        parts = zip(choice.logits.chunk(len(self.generators)), self.generators, strict=True)
        drawn = torch.cat([torch.empty_like(part).exponential_(generator=own) for part, own in parts])
        action = (choice.probs / drawn).argmax(-1)
        return written.update({"action": action, "action_log_prob": choice.log_prob(action)})

    def _found(self, view_ids: Tensor, goal_view_ids: Tensor) -> TensorDictBase:
        """Return what the runs answer where goals are to be found from states, ``[R, ...]``."""
        pair = self.world.pair(self.goal_index[goal_view_ids[..., 0]], view_ids[..., 0])
        return self.answers().gather(1, pair.flatten(1)).unflatten(1, pair.shape[1:])

    def each(self, function: Callable[..., Any], *rows: Any) -> Any:
        """Return the function of each run's own rows, with its weights in `form`; all are ``[R, ...]``."""

        def of_run(weights: TensorDictBase, kept: tuple[Tensor, ...], *own: Any) -> Any:
            self._own = kept
            with weights.to_module(self.form, preserve_module_state=False):
                return function(*own)

        return vmap(of_run)(self.weights, self._kept, *rows)

    def _embedded(self) -> tuple[Tensor, Tensor]:
        """Return the embeddings of all states and of all goals, ``[N, E]`` and ``[G, E]``."""
        encoder, features = self.form.encoder, self.form.features
        embed_goal = getattr(encoder, "embed_goal", encoder.embed)
        return encoder.embed(features(self.views)), embed_goal(features(self.goal_views))

    def _fused(self, view_ids: Tensor, goal_view_ids: Tensor) -> Tensor:
        """Return what the encoder makes of embeddings by view ids of observation and goal, int64 ``[B, 4]`` each."""
        rows, goal_rows = self._own
        goals = taken(goal_rows, self.goal_index[goal_view_ids[:, 0]])
        fused: Tensor = self.form.encoder.fuse(taken(rows, view_ids[:, 0]), goals)
        return fused

    @contextmanager
    def keeping(self, *, learns: bool) -> Iterator[None]:
        """Embed all once within this context of one update; for the losses too if it ``learns``."""
        with torch.set_grad_enabled(learns):
            self._kept = self.each(self._embedded)
        try:
            yield
        finally:
            self._kept, self._answers = (), None

    @torch.no_grad()
    def answers(self) -> Any:
        """Return what the runs answer to every pair of goal and state, ``[R, P]``, which a rollout looks up."""

        def of_run(scene: int, asked: TensorDictBase) -> Any:
            with in_scene(self.form, scene):
                return self.form(asked.copy()).select("logits", "state_value")

        if self._answers is None:
            self._answers = torch.cat([self.each(partial(of_run, *part)) for part in self.asked], 1)
        return self._answers

    def prepared(self, update: Callable[[], Any]) -> Callable[[], Any]:
        """Return the update as a CUDA graph, where there is a GPU."""
        generators = {*self.generators, *self.env.base_env.generators}
        return Captured(update, generators, self.stream) if self.stream is not None else update

    @torch.no_grad()
    def walked(self, protocols: Sequence[EvaluationProtocol], *, assess: bool = False) -> list[EvaluationProtocol]:
        """Return the protocols of the runs, equal but for their starts, with greedy episodes; to assess, with all."""
        world = self.world
        with self.keeping(learns=False):
            # Of every run for each pair, [R, P, 4]. One that has diverged is walked too: others do not wait.
            logits = self.answers()["logits"].nan_to_num()
        every_goal, every_start = zip(*(protocol.starts for protocol in protocols), strict=True)
        together = replace(protocols[0], starts=(torch.cat(every_goal), torch.cat(every_start)))
        episodes = len(every_start[0])  # of each run; those of the first come first
        goal_index = world.goal_index[together.world.goals]  # of those that are evaluated

        def decide(episode: Tensor, ahead: Tensor, _: Tensor, wanted: Tensor) -> Tensor:
            return logits[episode // episodes, world.pair(goal_index[wanted], ahead)]

        policies: Any = SimpleNamespace(decide=decide)  # each is asked in its own episodes
        kinds = [together.run(policies)]
        if assess:
            kinds += [together.run(policies, greedy=False), together.run_random()]
        rows_of_runs = torch.arange(len(together.starts[0]), device=world.device).split(episodes)
        return [
            replace(protocol, walked=tuple(kind.select(own) for kind in kinds))
            for protocol, own in zip(protocols, rows_of_runs, strict=True)
        ]


class StackedLosses:
    """The losses of each run, as `Losses` are those of one; every entry is ``[R]``."""

    def __init__(self, stack: Stack, form: Losses, demos: Sequence[TensorDictBase]) -> None:
        self.stack, self.form = stack, form
        self.recurrent, self.rewarded = form.recurrent, form.rewarded
        self.demonstrated = padded(demos) if max(map(len, demos)) else ()
        for name, loss in form.losses.items():
            loss.module.reduction = "none"  # rows are reduced without those that only fill up
            every = [state.losses.losses[name].schedules for state in stack.members]
            for option in loss.schedules:
                ends = [(own[option].start, own[option].end) for own in every]
                loss.schedules[option] = Schedule(*torch.tensor(ends, device=stack.device).T)

    def __call__(self, batch: TensorDictBase, left: Tensor) -> Any:
        """Return the weighted losses of a batch ``[R, B]``, see `Losses.forward`."""

        def of_run(batch: TensorDictBase, coefficients: Any, rows: Any = None, counts: Any = None) -> TensorDict:
            def reduce(name: str, value: Tensor) -> Tensor:
                return mean(value, counts if self.form.losses[name].on_demonstrations else None)

            return self.form.compute(batch, rows, coefficients, reduce)

        return self.stack.each(of_run, batch, self.form.coefficients(left), *self.demonstrated)


def stacked_weights(policies: Sequence[nn.Module]) -> TensorDict:
    """Return the parameters of all policies, ``[R, ...]`` each; the policies' own become views, gradients too.

    (``torch.func.stack_module_state`` copies them, and stacks what the runs share.)
    """
    every = [dict(policy.named_parameters()) for policy in policies]
    weights = {name: torch.stack([own[name] for own in every]).detach().requires_grad_() for name in every[0]}
    for name, weight in weights.items():
        weight.grad = torch.zeros_like(weight)
        for own, value, grad in zip(every, weight.detach(), weight.grad, strict=True):
            own[name].data, own[name].grad = value, grad
    return TensorDict(weights, batch_size=[len(every)]).unflatten_keys(".")


def with_tensors(configs: Sequence[TrainConfig], device: torch.device) -> TrainConfig:
    """Return the first configuration with tensors, which broadcast to batches, for numbers in which runs may differ."""

    def by_run(option: str, dims: int) -> Any:
        return torch.tensor([attrgetter(option)(own) for own in configs], device=device).view(-1, *[1] * dims)

    first = configs[0]
    reward = replace(first.reward, **{each.name: by_run(f"reward.{each.name}", 1) for each in fields(first.reward)})
    discount = {name: by_run(f"reinforcement.{name}", 3) for name in ("gamma", "lmbda")}
    return replace(first, reward=reward, reinforcement=replace(first.reinforcement, **discount))


def mean(value: Tensor, counts: Tensor | None) -> Tensor:
    """Return the mean of rows, without those that only fill up; see `padded`."""
    return value.mean() if counts is None else (value.flatten() * counts / counts.mean()).mean()


def padded(demos: Sequence[TensorDictBase]) -> tuple[TensorDictBase, Tensor]:
    """Return all runs' demonstrations, ``[R, M]``, and which count, float32 ``[R, M]``: others fill up the rows."""
    rows = torch.arange(max(map(len, demos)), device=demos[0].device)
    together = torch.stack([own[rows.clamp(max=len(own) - 1)] for own in demos])
    return together, torch.stack([rows < len(own) for own in demos]).float()


def taken(table: Tensor, index: Tensor) -> Tensor:
    """Return rows of a table, float32 ``[N, E]``, by their index, int64 ``[B]``.

    A gradient comes back from a GPU by a product with ones and zeros: in a fixed order, as sorting would do slowly.
    """
    if not torch.is_grad_enabled() or not reading_waits(table):
        return table[index]
    return (index[:, None] == torch.arange(len(table), device=index.device)).to(table.dtype) @ table


class Captured:
    """A function of no arguments that reads and writes tensors in place, as a CUDA graph from its second call on.

    Its result is overwritten by the next call. What cannot be captured is called as it is, and the reason is told in
    one line. (tensordict's ``CudaGraphModule`` synchronises before every replay, copies what it returns, and cannot
    register a generator.)
    """

    def __init__(self, function: Callable[[], Any], generators: set[torch.Generator], stream: Any) -> None:
        self.function, self.generators, self.stream = function, generators, stream
        self.graph: torch.cuda.CUDAGraph | None = None
        self.calls, self.result = 0, None

    def __call__(self) -> Any:
        """Call the function, or replay its graph."""
        self.calls += 1
        if self.calls == 2:  # in the first call kernels were loaded, and optimisers made their state
            self._capture()
        if self.graph is not None:
            self.graph.replay()
            return self.result
        self.stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(self.stream):
            result = self.function()
        torch.cuda.current_stream().wait_stream(self.stream)
        return result

    def _capture(self) -> None:
        graph = torch.cuda.CUDAGraph()
        for generator in self.generators:
            graph.register_generator_state(generator)
        try:
            with torch.cuda.graph(graph, stream=self.stream):
                self.result = self.function()
            self.graph = graph
        except Exception as error:
            reason = " ".join(str(error).split())[:200]
            print(f"no CUDA graph, each kernel is launched by itself: {reason}", file=sys.stderr, flush=True)
