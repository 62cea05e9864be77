"""A run from its configuration to its summary: components, folder, resumption, errors; its stages are given."""

import json
import os
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig
from torch import Tensor

from dirl.config.components import check_components, make, packages_to_trust
from dirl.config.files import read_config, typed
from dirl.config.folders import command
from dirl.config.schemas import ConfigError, Device, Precision, Starts, TrainConfig
from dirl.evaluation.protocol import EpisodeMeter, EvaluationProtocol, assess
from dirl.models import ActorCritic, plain_weights
from dirl.models.build import check_extractor
from dirl.perception.recognition.recogniser import build_recogniser, stop_by
from dirl.reporting import draw_learning_curve, draw_scene, run_title, summary_table
from dirl.runs.checkpoints import ARCHITECTURE, Facts, RunError, State, is_finished, load_checkpoint, restoring
from dirl.runs.exits import one_line_exits
from dirl.runs.folder import Run, open_run, peak_memory_mb
from dirl.scenes.io.files import read_text, write_json
from dirl.scenes.live import SimulatorError
from dirl.scenes.world import World
from dirl.training.build import (
    build_demonstrations,
    build_env,
    build_goals,
    build_losses,
    build_observation,
    build_protocol,
    build_world,
    describe,
    learning_policy,
)
from dirl.training.loops import TrainState
from dirl.training.objectives import trained_parameters
from dirl.training.pairs import Demonstrations


@dataclass
class Components:
    """What a configuration is made into."""

    world: World
    """With the goals of the training."""
    policy: ActorCritic
    """See `dirl.models.ActorCritic`."""
    demos: Demonstrations
    protocol: EvaluationProtocol
    """How the policy is evaluated: with the observation of the training, on all its goals or on some of them."""
    state: TrainState | None
    """Of the reinforcement; None if the run has none."""
    before_reinforcement: bool
    """True if the run is before its reinforcement: it is new, or goes on from a checkpoint of its imitation."""


NOT_REINFORCED = {"frames": 0, "frames_per_second": None, "stable_at_frame": None}
"""What a summary says of a run without reinforcement."""

DIVERGED = "the policy has diverged, its logits are not finite: lower imitation.lr, optimiser.lr or reward.scale"

DRAWN_SCENES = 8
"""Of how many scenes there are pictures at most; those of one take seconds."""

Stages = Callable[[Run, Components], Facts]
"""Trains the policy; returns what the summary says of it."""


def run_job(composed: DictConfig, stages: Stages, folder: Path | None = None, overrides: Sequence[str] = ()) -> Facts:
    """Run a job: build its components before anything is written, then run the stages; return the summary.

    It is that of Hydra, unless its folder is given and the options that it was composed with. If a run of Hydra alone
    goes wrong, the program ends with one line. Other errors are raised: one of a sweep fails its job, and others run.
    """
    alone = sweep = False
    if folder is None:
        hydra: Any = HydraConfig.get()
        folder, overrides = Path(hydra.runtime.output_dir), hydra.overrides.task
        folder = folder.relative_to(Path.cwd()) if folder.is_relative_to(Path.cwd()) else folder
        sweep = hydra.mode.name == "MULTIRUN"
        alone = not sweep
    try:
        # Hydra would say something of its own about an error before `dirl.cli.start.run` does.
        with one_line_exits(lambda: "nothing was trained", folder) if alone else nullcontext():
            run, initial = open_job(composed, folder, overrides)
            if is_finished(run.folder):  # and ``existing=keep``
                print(f"finished before: {run.folder}")
                summary: Facts = json.loads(read_text(run.folder / "summary.json"))
                return summary
            components = build_components(run, initial)
            run.begin(components.world, components.protocol.observation.order)
        with one_line_exits(run.how_to_go_on) if alone else nullcontext():
            return run_stages(run, components, stages)
    except Exception as error:
        if sweep:  # Hydra runs the other jobs, and says only at the end why the first of the failed ones failed
            print(f"failed: {folder}: {error}", file=sys.stderr, flush=True)
        raise


def open_job(composed: DictConfig, folder: Path, overrides: Sequence[str]) -> tuple[Run, State | None]:
    """Return the run of a job, new or to be continued, and the checkpoint that ``init`` names, if it was read."""
    config, initial = typed(composed), None
    if config.init is not None:
        config, initial = with_architecture(config, overrides)
    check_components(config, config.trust)
    run = open_run(config, folder, overrides)
    prepare_device(run.config.device, run.config.precision)
    return run, initial


def with_architecture(config: TrainConfig, overrides: Sequence[str]) -> tuple[TrainConfig, State]:
    """Return the configuration with the architecture of the checkpoint that ``init`` names, and that checkpoint.

    Raises:
        ConfigError: an option of the architecture is given beside ``init``.
        RunError: there is no such checkpoint, or it is damaged.
    """
    assert config.init is not None
    texts = [text.lstrip("+") for text in overrides]
    given = [text for text in texts if text.partition("=")[0].partition(".")[0] in ARCHITECTURE]
    if given:
        raise ConfigError(f"init={config.init}: its checkpoint decides the architecture; leave out {' '.join(given)}")
    saved = load_checkpoint(config.init)
    trained = read_config(saved["config"], config.init, trust=config.trust or [])
    return replace(config, **{name: getattr(trained, name) for name in ARCHITECTURE}), saved


def prepare_device(device: Device, precision: Precision = Precision.float32) -> None:
    """Choose kernels that add in a fixed order on a GPU: a seed decides as on the CPU.

    torch warns of an operation that has no such kernel.
    """
    if device != Device.cuda:
        return
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")  # cuBLAS reads it when it is first used
    torch.use_deterministic_algorithms(True, warn_only=True)
    torch.utils.deterministic.fill_uninitialized_memory = False  # type: ignore[attr-defined]  # which is a kernel for every tensor that is made
    torch.backends.cuda.matmul.allow_tf32 = precision == Precision.tf32


def build_components(run: Run, initial: State | None = None, like: Components | None = None) -> Components:
    """Build everything that the configuration asks for, with the weights that the run begins or goes on with.

    ``initial`` is the checkpoint that ``init`` names, if it has been read. With ``like``, those of another run in the
    same world, what does not depend on the run is shared.
    """
    world = build_world(run.config) if like is None else like.world
    observation = build_observation(run.config, world)
    weights = None
    if run.config.init is not None:
        weights = initial_weights(run.config, world, run.saved or initial or load_checkpoint(run.config.init))
    features = None if like is None or weights is not None else like.policy.features
    policy = learning_policy(run.config, world, observation, weights, features)
    demos = build_demonstrations(run.config, world, observation)
    losses = build_losses(run.config, policy, world, demos) if trained_parameters(policy) else None
    goals = build_goals(run.config, world.scenes)
    if like is None or run.config.evaluation.starts != Starts.every:
        protocol = build_protocol(run.config, world, observation, goals.held_out)
    else:
        protocol = replace(like.protocol, seed=run.config.seed)
    if "simulator" in run.config.env:
        from dirl.training.simulation import live_protocol, open_live  # late, see `build_env`

        live = open_live(run.config, world, observation)
        protocol = replace(protocol, live=live_protocol(run.config, live, world, observation))
    state = None
    if losses is not None and losses.on_rollouts:
        trained = trained_parameters(policy, losses)
        optimiser = make("optimiser", run.config.optimiser, run.config.trust, params=trained)
        env, meter = build_env(run.config, world, observation, policy), EpisodeMeter(len(world.goals))
        state = TrainState(run.config, policy, losses, trained, optimiser, env, env.reset(), meter)
    before_reinforcement = run.saved is None or "imitation" in run.saved
    if state is not None and run.saved is not None and not before_reinforcement:
        with restoring(run.folder):
            state.load_state_dict(run.saved)
    for name, states in goals.left_out.items():
        shown = ", ".join(map(str, states[:5])) + (", ..." if len(states) > 5 else "")
        print(f"{name}: {len(states)} states are no goals, because most states cannot reach them: {shown}")
    return Components(world, policy, demos, protocol, state, before_reinforcement)


def initial_weights(config: TrainConfig, world: World, saved: State) -> Mapping[str, Tensor]:
    """Return the weights that a training with ``init`` begins with, by name.

    ``saved`` is the checkpoint that ``init`` names, or the one that the run itself resumes from.

    Raises:
        ConfigError: they were trained on the features of another extractor, or have heads for other scenes.
    """
    check_extractor(saved, world.scenes[0].extractor, f"init={config.init}")
    unknown = sorted(set(world.names) - set(saved["scenes"]))
    if unknown and not config.heads.get("shared"):
        raise ConfigError(f"init={config.init}: has heads for the scenes {saved['scenes']}, none for {unknown[0]}")
    return saved["network"]


def run_stages(run: Run, components: Components, stages: Stages) -> Facts:
    """Run the stages; evaluate, and write the summary. A policy that learns nothing is evaluated only.

    Raises:
        RunError: the policy has diverged, or its simulator has failed.
    """
    policy, protocol = components.policy, components.protocol
    if run.saved is None:
        torch.manual_seed(run.config.seed)
    facts = describe(run.config, protocol.world) | {"demonstrations": len(components.demos)}
    print(f"{run_title(facts)}: {run.folder}")
    if not trained_parameters(policy):
        summary = facts | {"frames": 0, "seconds": run.seconds} | assess(policy, protocol)
        write_json(run.folder / "summary.json", summary)
        print(summary_table(summary))
        run.clean_up(summary)
        return summary
    try:
        return conclude(run, policy, protocol, facts | stages(run, components))
    except SimulatorError as error:
        raise RunError(f"{error.failure}; {run.how_to_go_on()}") from None
    except RuntimeError as error:  # torch draws no actions by logits that are not finite
        if "probability tensor contains" not in str(error):
            raise
        raise RunError(DIVERGED) from None


def conclude(run: Run, policy: ActorCritic, protocol: EvaluationProtocol, facts: Facts, *, shown: bool = True) -> Facts:
    """Evaluate and write the summary; unless the run is one of a stack, show it as a table and in pictures.

    Raises:
        RunError: the policy has diverged.
    """
    if not all(bool(weights.isfinite().all()) for weights in policy.parameters()):
        raise RunError(DIVERGED)
    measures = assess(policy, protocol)
    summary = NOT_REINFORCED | facts | {"seconds": run.seconds, "peak_memory_mb": peak_memory_mb()} | measures
    run.finish({"frames": summary["frames"], "network": plain_weights(policy)}, summary)
    if not shown:
        run.clean_up(summary)
        return summary
    print(summary_table(summary))
    draw_learning_curve(run.folder, run.folder / "learning_curve.png")
    recogniser = build_recogniser(run.config.recogniser, protocol.world.device, run.config.trust)
    stop = stop_by(recogniser, run.config.stop.threshold, run.config.stop.match)
    for index in range(min(DRAWN_SCENES, len(protocol.world.scenes))):
        draw_scene(policy, protocol, index, run.folder, matching=stop, facts=summary)
    run.clean_up(summary)
    print(f"pictures, metrics and weights: {run.folder}")
    if outside := packages_to_trust(run.config):
        options = shlex.join([f"checkpoint={run.folder}", f"trust=[{','.join(outside)}]"])
        print(f"evaluate it with: {command('evaluate')} {options}")
    return summary
