"""Train an agent to find its goals: imitation of a few demonstrations, then actor-critic.

    python recipes/train.py scene=bathroom_02
    python recipes/train.py scene=all seed=1 logger=wandb
    python recipes/train.py scene=kitchen_02 preset=paper system=td_drl
    python recipes/train.py -m scene=bathroom_02 imitation.fraction=0,0.05,0.5 seed=0,1,2
    python recipes/train.py -m experiment=fig8
    python recipes/train.py resume=runs/dirl_bathroom_02/2026-01-31_12-00-00

All options with their values: conf/train.yaml and the groups beside it.
"""

from dirl.commands.start import run_main, start

if __name__ == "__main__":
    start("train")  # answers help and refuses options, before the imports below take their time

import json
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

import hydra
import torch
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig
from torch import nn
from tqdm import tqdm

from dirl.commands.command_line import job_errors, one_line_errors
from dirl.config.components import check_components
from dirl.config.places import CONF
from dirl.config.schemas import Precision, TrainConfig, typed
from dirl.evaluation.episodes import bar_interval
from dirl.evaluation.experts import label
from dirl.evaluation.protocol import EvaluationProtocol, mean_shortest, metrics
from dirl.evaluation.stability import EpisodeMeter
from dirl.models import caching, count_parameters, noisy, recurrent_keys
from dirl.reporting import run_title
from dirl.runs import ranks
from dirl.runs.exits import interruptible, leave, one_line_exits
from dirl.runs.folder import Run, open_run
from dirl.runs.states import check_training
from dirl.training import hogwild
from dirl.training.build import (
    build_demonstrations,
    build_env,
    build_expert,
    build_goals,
    build_imitation_loss,
    build_losses,
    build_observation,
    build_optimiser,
    build_protocol,
    build_world,
    describe,
    trained_parameters,
)
from dirl.training.conclusion import conclude, conclude_untrained
from dirl.training.initial import initial_weights, with_architecture
from dirl.training.load import learning_policy
from dirl.training.losses import (
    Advantages,
    Losses,
    clip_gradients,
    demonstration_batches,
    minibatches,
    set_learning_rate,
    total_loss,
)
from dirl.training.pairs import Demonstrations, with_labels
from dirl.training.progress import due, is_done
from dirl.training.rollout import Update, collect, summarise, together
from dirl.training.state import Record, TrainState, begin_imitation, in_imitation

NOT_REINFORCED = {"frames": 0, "frames_per_second": None, "stable_at_frame": None, "near_shortest_at_frame": None}
"""What a summary says of a run without reinforcement."""

ROWS = 200
"""Rows of reinforcement.csv, evenly spread over the training."""


@hydra.main(version_base="1.3", config_path=str(CONF), config_name="train")
def main(composed: DictConfig) -> float:
    """Train: one run, or one job of a sweep; returns the greedy SPL, which sweepers maximise."""
    folder = Path(HydraConfig.get().runtime.output_dir)
    folder = folder.relative_to(Path.cwd()) if folder.is_relative_to(Path.cwd()) else folder
    if HydraConfig.get().mode == RunMode.MULTIRUN:
        with job_errors(folder):
            return train(composed, folder, alone=False)["greedy"]["spl"]
    return train(composed, folder, alone=True)["greedy"]["spl"]


def train(composed: DictConfig, folder: Path, *, alone: bool) -> dict[str, Any]:
    """Build the components of the run before anything is written; then run its stages. Returns the summary.

    An error ends a run that is alone with one line. In a sweep it fails the job, and Hydra runs the others.
    """
    # Without the inner one Hydra would say something of its own about an error of the machine.
    with one_line_exits() if alone else nullcontext(), one_line_errors(folder) if alone else nullcontext():
        overrides = HydraConfig.get().overrides.task
        config, initial = with_architecture(typed(composed), overrides)
        check_components(config, config.trust)
        ranks.join(config, alone=alone)
        run = open_run(config, folder, overrides)
        if ranks.from_first(lambda: run.finished):
            print(f"finished before: {run.folder}")
            return ranks.from_first(lambda: json.loads((run.folder / "summary.json").read_text()))
        world = build_world(run.config)
        observation = build_observation(run.config, world)
        weights = initial_weights(run.config, world, run.saved or initial)
        policy = learning_policy(run.config, world, observation, weights)
        ranks.agree(policy)
        demos = build_demonstrations(run.config, world, observation)
        losses = build_losses(run.config, policy, world, demos) if count_parameters(policy) else None
        goals = build_goals(run.config, world.scenes)
        protocol = build_protocol(run.config, world, observation, goals.held_out)
        state = begin(run, policy, losses, protocol) if losses is not None and losses.on_rollouts else None
        run.begin(world, observation.order)
    for name, states in goals.left_out.items():
        shown = ", ".join(map(str, states[:5])) + (", ..." if len(states) > 5 else "")
        print(f"{name}: {len(states)} states are no goals, because most states cannot reach them: {shown}")
    with one_line_exits(run.how_to_go_on) if alone else nullcontext(), one_line_errors() if alone else nullcontext():
        return run_stages(run, policy, demos, state, protocol)


def begin(run: Run, policy: nn.Module, losses: Losses, protocol: EvaluationProtocol) -> TrainState:
    """The state of the training before its first update, or from the checkpoint that the run continues."""
    optimiser = build_optimiser(run.config, policy, losses)
    agents = ranks.share_of_agents(run.config, len(protocol.world.scenes))
    seed = ranks.own_seed(run.config.seed)
    env = build_env(run.config, protocol.world, protocol.observation, policy, agents=agents, seed=seed)
    meter = EpisodeMeter(mean_shortest(protocol.world))
    state = TrainState(policy, losses, optimiser, env, env.reset(), meter)
    if run.saved is not None and not in_imitation(run):
        check_training(run.saved, state.state_dict(), env, optimiser, str(run.folder))
        state.load_state_dict(run.saved)
    return state


def run_stages(
    run: Run, policy: nn.Module, demos: Demonstrations, state: TrainState | None, protocol: EvaluationProtocol
) -> dict[str, Any]:
    """Imitation, reinforcement unless ``state`` is None, evaluation; a policy that learns nothing is evaluated only."""
    if run.saved is None:
        torch.manual_seed(ranks.own_seed(run.config.seed))
    facts = describe(run.config, protocol.world) | {"demonstrations": len(demos)}
    print(f"{run_title(facts)}: {run.folder}")
    if not count_parameters(policy):
        return ranks.from_first(lambda: conclude_untrained(run, policy, protocol, facts))
    walked = {}
    begins = run.saved is None or in_imitation(run)
    if begins and len(demos):
        step = imitate(run, policy, demos)
        walked = aggregate(run, policy, protocol, demos, step)
    if begins and run.config.evaluation.times:
        evaluate(run, policy, protocol, 0)
    trained = NOT_REINFORCED if state is None else reinforce(run, state, protocol)
    return ranks.from_first(lambda: conclude(run, policy, protocol, facts | trained | walked))


def imitate(run: Run, policy: Any, demos: Demonstrations, done: int = 0) -> int:
    """Clone the expert, on all demonstrations or minibatches, until its actions are learnt (paper section 3.3).

    Args:
        run: gets a row of ``imitation.csv`` a step, and unless this is a round of DAgger its checkpoints.
        policy: whose encoder and policy head are trained.
        demos: what the expert did.
        done: steps so far.

    Returns:
        Steps so far.
    """
    options, last = run.config.imitation, done + run.config.imitation.max_steps
    draw, trunk = demonstration_batches(policy, demos, options.batch_size), policy.trunk()
    loss, state = build_imitation_loss(run.config, policy), begin_imitation(run, policy, done)
    hidden = not options.drawn or ranks.rank() > 0
    stop: list[int] = []
    bar = tqdm(total=last - done, initial=state.step - done, unit=" steps", mininterval=bar_interval(), disable=hidden)
    with interruptible() as asked, bar:
        while state.step < last and not state.loss < options.loss_threshold and not stop:
            if options.lr_decay:
                set_learning_rate(state.optimiser, options.lr * (1 - (state.step - done) / options.max_steps))
            rows = draw()
            with noisy(policy, options.noise):
                result = loss(trunk(rows.copy()))
            state.optimiser.zero_grad()
            result["loss_imitation"].backward()
            ranks.average_gradients(policy.parameters(), len(rows))
            state.optimiser.step()
            own = (result["loss_imitation"].item(), result["accuracy"].item(), len(rows))
            parts, stop, save = ranks.tell(own, asked, run.save_due())
            state.count(parts)
            run.write("imitation", state.step, {"step": state.step, "loss": state.loss, "accuracy": state.accuracy})
            bar.update()
            if (save or stop) and not done:
                run.save(state.state_dict())
    if stop:
        leave("interrupted", 128 + stop[0], run.how_to_go_on)
    print(f"{len(demos)} demonstrations, {state.step} steps of imitation: {state.accuracy:.1%} of the actions learnt")
    return state.step


def aggregate(run: Run, policy: Any, protocol: EvaluationProtocol, demos: Demonstrations, done: int) -> dict[str, Any]:
    """DAgger (Ross et al. 2011): the learner walks, the expert labels the states it came to, all is cloned again.

    Writes a row of ``dagger.csv`` a round: frames walked so far, states and goals labelled so far, and the metrics of
    the clone. Returns what the summary says of it.
    """
    config, world = run.config, protocol.world
    options = config.imitation
    if options.rounds == 0:
        return {}
    env, operator = build_env(config, world, protocol.observation, policy), policy.operator()
    expert = build_expert(config, world)
    agents, frames = env.reset(), 0
    for number in range(1, options.rounds + 1):
        batch, agents = collect(env, operator, agents, options.walk_steps)
        frames += batch.numel()
        demos = with_labels(demos, label(expert, batch.reshape(-1)))
        done = imitate(run, policy, demos, done)
        row = {"round": number, "frames": frames, "labels": len(demos)}
        run.write("dagger", number, row | metrics(protocol.run(policy)))
    return {"frames": frames, "demonstrations": len(demos)}


def reinforce(run: Run, state: TrainState, protocol: EvaluationProtocol) -> dict[str, Any]:
    """Improve the policy by actor-critic (paper section 3.2); returns what the summary says of the training."""
    config = run.config
    total = config.reinforcement.frames_per_scene * len(protocol.world.scenes)
    hidden = ranks.rank() > 0
    bar = tqdm(
        total=total, initial=state.frames, unit=" frames", unit_scale=True, mininterval=bar_interval(), disable=hidden
    )
    stop: list[int] = []
    with interruptible() as asked, bar:

        def record(update: Update, paused: AbstractContextManager[None]) -> None:
            updates, signals, save = ranks.tell(update, asked, run.save_due())
            stop.extend(signals)
            update = together(updates)
            after_update(run, state, update, protocol, total, paused, save=save)
            bar.update(update.frames)
            bar.set_postfix_str(f"ATL {state.meter.atl:.1f}", refresh=False)
            if is_done(config, state.meter, state.frames, total):
                stop.append(0)

        state.start_clock()
        chosen = hogwild.learn if config.reinforcement.workers > 1 else learn
        if not is_done(config, state.meter, state.frames, total):
            chosen(config, state, total, record, stop)
        if stop and not is_done(config, state.meter, state.frames, total):
            run.save(state.state_dict())
            bar.close()
            leave("interrupted", 128 + stop[0], run.how_to_go_on)
    stable = {"stable_at_frame": state.meter.stable_at, "near_shortest_at_frame": state.meter.near_at}
    return {"frames": state.frames, "frames_per_second": state.frames / state.seconds, **stable}


def learn(config: TrainConfig, state: TrainState, total: int, record: Record, stop: Sequence[int]) -> None:
    """Collect, losses, backward, clip, step; until ``total`` frames or until there is anything in ``stop``."""
    options, optimiser, policy = config.reinforcement, state.optimiser, state.policy
    operator, advantages = policy.operator(), Advantages(policy, options.gamma, options.lmbda)
    parameters, rate = trained_parameters(policy, state.losses), optimiser.defaults["lr"]
    by_agent = bool(recurrent_keys(policy))
    bfloat16 = config.precision == Precision.bfloat16
    while state.frames < total and not stop:
        left = 1 - state.frames / total
        set_learning_rate(optimiser, rate * left)
        with caching(policy), torch.autocast(state.env.device.type, torch.bfloat16, enabled=bfloat16):
            batch, state.agents = collect(state.env, operator, state.agents, options.n_steps)
            batch = advantages(batch)
            for part in minibatches(batch, options.epochs, options.minibatches, by_agent=by_agent):
                losses = state.losses(part, left)
                optimiser.zero_grad()
                total_loss(losses).backward()
                ranks.average_gradients(parameters, len(part))
                clip_gradients(parameters, options.max_grad_norm, per_variable=options.clip_per_variable)
                optimiser.step()
        record(summarise(state.env, batch, losses), nullcontext())


def after_update(
    run: Run,
    state: TrainState,
    update: Update,
    protocol: EvaluationProtocol,
    total: int,
    paused: AbstractContextManager[None],
    *,
    save: bool,
) -> None:
    """Count an update; write, evaluate and save when they are due, the latter two within ``paused``."""
    before = state.frames
    state.count(update)
    frames, meter = state.frames, state.meter
    if due(before, frames, total, ROWS):
        row = {"frames": frames, "seconds": state.seconds, "frames_per_second": frames / state.seconds}
        row |= {"atl": meter.atl, "atl_worst_goal": meter.worst_atl, "episodes": meter.episodes}
        run.write("reinforcement", frames, row | update.values)
    evaluates = due(before, frames, total, run.config.evaluation.times)
    saves = save or is_done(run.config, meter, frames, total)
    if evaluates or saves:
        with paused:
            if evaluates:
                evaluate(run, state.policy, protocol, frames)
            if saves:
                run.save(state.state_dict())
    state.start_clock()


def evaluate(run: Run, policy: nn.Module, protocol: EvaluationProtocol, frames: int) -> None:
    """Evaluate the policy as it is, greedily; in rank 0."""

    def row() -> dict[str, float | int]:
        found = {"frames": frames, **metrics(protocol.run(policy))}
        if protocol.held_out is not None:
            apart = metrics(protocol.held_out.run(policy))
            found |= {f"held_out_{key}": apart[key] for key in ("sr", "spl")}
        return found

    run.write("evaluation", frames, ranks.from_first(row))


if __name__ == "__main__":
    run_main(main)
