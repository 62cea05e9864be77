"""Train an agent to find its goals: imitation of a few demonstrations, then actor-critic.

    python recipes/train.py scene=bathroom_02
    python recipes/train.py scene=all seed=1 logger=wandb
    python recipes/train.py scene=kitchen_02 preset=paper system=td_drl
    python recipes/train.py -m scene=bathroom_02 imitation.share=0,0.05,0.5 seed=0,1,2
    python recipes/train.py -m experiment=fig8
    python recipes/train.py resume=runs/dirl_bathroom_02/2026-01-31_12-00-00

All options with their values: conf/train.yaml and the groups beside it.
"""

import resource
import sys
import time
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import hydra
import torch
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase
from tqdm import tqdm

from dirl.config.command_line import check_overrides, job_errors, one_line_errors, register
from dirl.config.schemas import Objective, PolicyName, Precision, TrainConfig, typed
from dirl.evaluation import mean_shortest, metrics
from dirl.experts import label, merge_demonstrations
from dirl.models import actor_critic
from dirl.objectives import ImitationLoss
from dirl.reporting import draw_learning_curve, run_title, summary_table
from dirl.reporting.pictures import draw_scene
from dirl.runs.folder import Run, interruptible, open_run
from dirl.training.build import Parts, assess, build_env, build_optimiser, describe, learning_parts, run_policy
from dirl.training.hogwild import asynchronous_updates, fetch, share, waiting
from dirl.training.losses import Update, make_gradients, set_learning_rate, summarise
from dirl.training.progress import EpisodeMeter
from dirl.training.rollout import collect

ROWS = 200
"""Rows of reinforcement.csv, evenly spread over the training."""


@hydra.main(version_base="1.3", config_path="../conf", config_name="train")
def main(composed: DictConfig) -> None:
    """Train: one run, or one job of a sweep."""
    folder = Path(HydraConfig.get().runtime.output_dir)
    folder = folder.relative_to(Path.cwd()) if folder.is_relative_to(Path.cwd()) else folder
    if HydraConfig.get().mode == RunMode.MULTIRUN:
        with job_errors(folder):
            train(*set_up(composed, folder))
    else:
        with one_line_errors(folder):
            run, parts = set_up(composed, folder)
        train(run, parts)


def set_up(composed: DictConfig, folder: Path) -> tuple[Run, Parts | None]:
    """The run and its parts, made before anything is written; no parts if it was finished before."""
    run = open_run(typed(composed), folder, HydraConfig.get().overrides.task)
    if run.finished:
        return run, None
    parts = learning_parts(run.config)
    run.begin(parts.world)
    return run, parts


def train(run: Run, parts: Parts | None) -> None:
    """Run the stages one after the other, and show what came out."""
    if parts is None:
        print(f"finished before: {run.folder}")
        return
    torch.manual_seed(run.config.seed)
    print(f"{run_title(describe(parts))}: {run.folder}")
    if run.config.policy != PolicyName.network:
        measure(parts, run)
        return
    walked = {}
    if run.saved is None and len(parts.demos):
        step = imitate(parts, run, parts.demos)
        walked = aggregate(parts, run, step)
    conclude(parts, run, reinforce(parts, run) | walked)


def measure(parts: Parts, run: Run) -> None:
    """Evaluate a policy that learns nothing."""
    summary = describe(parts) | {"frames": 0, "seconds": run.seconds} | assess(parts)
    run.write_summary(summary)
    print(summary_table(summary))


def imitate(parts: Parts, run: Run, demos: TensorDictBase, done: int = 0) -> int:
    """Clone the expert, by full-batch steps until its actions are learnt (paper section 3.3).

    Args:
        parts: of the run.
        run: gets a row of ``imitation.csv`` a step.
        demos: what the expert did, ``[M]``, with views.
        done: steps so far.

    Returns:
        Steps so far.
    """
    options = parts.config.imitation
    operator = actor_critic(parts.network)
    trunk = operator.module[0]
    loss = ImitationLoss(operator.get_policy_head())
    optimiser = torch.optim.Adam(parts.network.parameters(), lr=options.lr)  # the value head gets no gradient
    for step in range(done + 1, done + options.max_steps + 1):
        result = loss(trunk(demos.copy()))
        optimiser.zero_grad()
        result["loss_imitation"].backward()
        optimiser.step()
        row = {"step": step, "loss": result["loss_imitation"].item(), "accuracy": result["accuracy"].item()}
        run.write("imitation", step, row)
        if row["loss"] < options.enough:
            break
    print(f"{len(demos)} demonstrations, {step} steps of imitation: {row['accuracy']:.1%} of the actions learnt")
    return step


def aggregate(parts: Parts, run: Run, done: int) -> dict[str, Any]:
    """DAgger (Ross et al. 2011): the learner walks, the expert labels the states it came to, all is cloned again.

    Writes a row of ``dagger.csv`` a round: frames walked so far, states and goals labelled so far, and what the clone
    is worth. Returns what the summary says of it.
    """
    options, world = parts.config.imitation, parts.world
    if options.rounds == 0:
        return {}
    env, operator = build_env(parts), actor_critic(parts.network)
    agents, demos, frames = env.reset(), parts.demos, 0
    for number in range(1, options.rounds + 1):
        batch, agents = collect(env, operator, agents, options.walk)
        frames += batch.numel()
        demos = merge_demonstrations(demos, label(world, batch.reshape(-1)))
        done = imitate(parts, run, demos, done)
        row = {"round": number, "frames": frames, "labels": len(demos)}
        run.write("dagger", number, row | metrics(run_policy(parts)))
    return {"frames": frames, "demonstrations": len(demos)}


def reinforce(parts: Parts, run: Run) -> dict[str, Any]:
    """Improve the policy by actor-critic (paper section 3.2); returns what the summary says of the training."""
    config, world, network = parts.config, parts.world, parts.network
    options = config.reinforcement
    if run.saved is None:
        test(parts, run, 0)
    if config.objective.name == Objective.none:
        return {"frames": 0, "frames_per_second": None, "stable_at_frame": None, "near_shortest_at_frame": None}
    optimiser = build_optimiser(parts)
    operator, gradients = actor_critic(network), make_gradients(parts, network)
    rounds = config.precision == Precision.bfloat16
    env = build_env(parts)
    agents = env.reset()
    meter = EpisodeMeter(mean_shortest(world))
    total = options.frames_per_scene * len(world.scenes)
    frames, seconds, began, shared = 0, 0.0, 0.0, None

    def state() -> dict[str, Any]:
        return {
            "frames": frames,
            "training_seconds": seconds,
            "network": network.weights_on_features(),
            "learning": network.state_dict(),
            "optimiser": optimiser.state_dict(),
            "agents": agents.to_dict(),
            "meter": meter.state_dict(),
            "random": random_state(env),
        }

    if run.saved is not None:
        frames, seconds = run.saved["frames"], run.saved["training_seconds"]
        network.load_state_dict(run.saved["learning"])
        optimiser.load_state_dict(run.saved["optimiser"])
        agents = TensorDict(run.saved["agents"], batch_size=env.batch_size, device=env.device)
        meter.load_state_dict(run.saved["meter"])
        restore_random_state(env, run.saved["random"])

    def record(update: Update) -> None:
        """Count an update; write, test and save where it is time to."""
        nonlocal frames, seconds, began
        before, frames = frames, frames + update.frames
        seconds += time.perf_counter() - began
        meter.add(update.goal_index, update.steps, frames)
        bar.update(update.frames)
        bar.set_postfix_str(f"ATL {meter.atl:.1f}", refresh=False)
        if due(before, frames, total, ROWS):
            progress = {"frames": frames, "seconds": seconds, "frames_per_second": frames / seconds}
            progress |= {"atl": meter.atl, "atl_worst_goal": meter.worst_atl, "episodes": meter.episodes}
            run.write("reinforcement", frames, progress | update.values)
        tests, saves = due(before, frames, total, config.evaluation.times), run.save_due() or frames >= total
        if tests or saves:
            with nullcontext() if shared is None else waiting(shared, network):
                if tests:
                    test(parts, run, frames)
                if saves:
                    run.save(state())
        began = time.perf_counter()

    often = 0.2 if sys.stderr.isatty() else 10.0
    bar = tqdm(total=total, initial=frames, unit=" frames", unit_scale=True, mininterval=often)
    began = time.perf_counter()
    with interruptible() as interrupted, bar:
        if options.workers > 1 and frames < total:
            shared = share(network, optimiser, frames)
            for update in asynchronous_updates(config, shared, total, interrupted):
                record(update)
        while frames < total and not interrupted:
            left = 1 - frames / total
            set_learning_rate(optimiser, config.optimiser.lr * left)
            with network.encoder.remembering(), torch.autocast(env.device.type, torch.bfloat16, enabled=rounds):
                batch, agents = collect(env, operator, agents, options.steps)
                for result in gradients(batch, left):  # noqa: B007
                    optimiser.step()
            record(summarise(env, batch, result))
        if interrupted and frames < total:
            if shared is not None:
                fetch(shared, network)
            run.save(state())
            bar.close()
            raise SystemExit(f"interrupted; go on with: python recipes/train.py resume={run.folder}")
    stable = {"stable_at_frame": meter.stable_at, "near_shortest_at_frame": meter.near_at}
    return {"frames": frames, "frames_per_second": frames / seconds, **stable}


def due(before: int, now: int, total: int, times: int) -> bool:
    """Whether one of ``times`` moments, evenly spread over ``total`` frames, lies between two counts of frames."""
    return before * times // total < now * times // total


def test(parts: Parts, run: Run, frames: int) -> None:
    """Evaluate the policy as it is, greedily."""
    result = metrics(run_policy(parts))
    run.write("evaluation", frames, {"frames": frames, **result})


def conclude(parts: Parts, run: Run, trained: dict[str, Any]) -> None:
    """Evaluate, write the summary, show it as a table and in pictures."""
    parts.network.encoder.use_features()
    measures = assess(parts)
    costs = {"seconds": run.seconds, "peak_memory_mb": peak_memory_mb()}
    summary = describe(parts) | trained | costs | measures
    run.finish({"frames": trained["frames"], "network": parts.network.state_dict()}, summary)
    print(summary_table(summary))
    draw_learning_curve(run.folder, run.folder / "learning_curve.png")
    for index in range(len(parts.world.scenes)):
        draw_scene(parts, index, run.folder)
    run.clean_up()
    print(f"pictures, metrics and weights: {run.folder}")


def random_state(env: EnvBase) -> dict[str, Tensor]:
    """The state of everything that draws random numbers during training."""
    state = {"env": env.base_env.generator.get_state(), "cpu": torch.get_rng_state()}
    return state | ({"cuda": torch.cuda.get_rng_state()} if env.device.type == "cuda" else {})


def restore_random_state(env: EnvBase, state: dict[str, Tensor]) -> None:
    """Undo what has been drawn since `random_state`."""
    env.base_env.generator.set_state(state["env"])
    torch.set_rng_state(state["cpu"])
    if "cuda" in state:
        torch.cuda.set_rng_state(state["cuda"])


def peak_memory_mb() -> float:
    """The most memory this process has held, in megabytes."""
    status = Path("/proc/self/status")
    if status.exists():  # on Linux `getrusage` would count what the parent of a new process held
        return int(status.read_text().split("VmHWM:")[1].split()[0]) * 1024 / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024) / 1e6


if __name__ == "__main__":
    register()
    with one_line_errors():
        check_overrides(TrainConfig, sys.argv[1:], groups=["experiment"])
    main()
