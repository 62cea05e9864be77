"""Train an agent to find its goals: imitation of a few demonstrations, then actor-critic.

    python recipes/train.py scene=bathroom_02
    python recipes/train.py scene=all seed=1 logger=wandb
    python recipes/train.py scene=kitchen_02 preset=paper system=td_drl
    python recipes/train.py -m scene=bathroom_02 imitation.share=0,0.05,0.5 seed=0,1,2
    python recipes/train.py resume=runs/dirl_bathroom_02/2026-01-31_12-00-00

All options with their values: conf/train.yaml and the groups beside it.
"""

import resource
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import hydra
import torch
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torch.nn.utils import clip_grad_norm_
from torchrl.envs import EnvBase
from tqdm import tqdm

from dirl.assemble import (
    Parts,
    assess,
    build_env,
    build_optimiser,
    describe,
    learning_parts,
    run_policy,
    run_trajectories,
)
from dirl.collection import collect
from dirl.commandline import check_overrides, one_line_errors, register
from dirl.config import ObjectiveConfig, Precision, TrainConfig, typed
from dirl.evaluation import action_values, metrics
from dirl.models import TemplateStop, actor_critic
from dirl.objectives import ImitationLoss, bootstrap, clip_each, make_advantages, make_loss
from dirl.reporting import (
    draw_learning_curve,
    draw_policy,
    draw_trajectories,
    run_title,
    summary_table,
    write_gif,
)
from dirl.runs import EpisodeMeter, Run, interruptible, open_run

ROWS = 200
"""Rows of reinforcement.csv, evenly spread over the training."""


@hydra.main(version_base="1.3", config_path="../conf", config_name="train")
def main(composed: DictConfig) -> None:
    """Set up, run the stages one after the other, and show what came out."""
    folder = Path(HydraConfig.get().runtime.output_dir)
    folder = folder.relative_to(Path.cwd()) if folder.is_relative_to(Path.cwd()) else folder
    with one_line_errors(folder):
        run = open_run(typed(composed), folder, HydraConfig.get().overrides.task)
        parts = learning_parts(run.config)
        run.begin(parts.world)
    torch.manual_seed(run.config.seed)
    world = parts.world
    print(f"{run.config.system} in {', '.join(world.names)} (source: {world.source}), seed {run.config.seed}: {folder}")

    if run.saved is None and len(parts.demos):
        imitate(parts, run)
    trained = reinforce(parts, run)
    conclude(parts, run, trained)


def imitate(parts: Parts, run: Run) -> None:
    """Clone the expert, by full-batch steps until its actions are learnt (paper section 3.3)."""
    options = parts.config.imitation
    operator = actor_critic(parts.network)
    trunk = operator.module[0]
    loss = ImitationLoss(operator.get_policy_head())
    optimiser = torch.optim.Adam(parts.network.parameters(), lr=options.lr)  # the value head gets no gradient
    for step in range(1, options.max_steps + 1):
        result = loss(trunk(parts.demos.copy()))
        optimiser.zero_grad()
        result["loss_imitation"].backward()
        optimiser.step()
        row = {"step": step, "loss": result["loss_imitation"].item(), "accuracy": result["accuracy"].item()}
        run.write("imitation", step, row)
        if row["loss"] < options.enough:
            break
    print(f"{len(parts.demos)} demonstrations, {step} steps of imitation: {row['accuracy']:.1%} of the actions learnt")


def reinforce(parts: Parts, run: Run) -> dict[str, Any]:
    """Improve the policy by actor-critic (paper section 3.2); returns what the summary says of the training."""
    config, world, network, demos = parts.config, parts.world, parts.network, parts.demos
    options = config.reinforcement
    operator = actor_critic(network)
    trunk, critic = operator.module[0], operator.get_value_operator()
    advantages = make_advantages(options.gamma, options.lmbda)
    objective = make_loss(
        config.objective.name,
        operator,
        entropy=options.entropy,
        value=options.value,
        clip=config.objective.clip,
        reduction=options.reduction,
    )
    imitation = ImitationLoss(operator.get_policy_head(), coeff=config.imitation.keep)
    rounds = config.precision == Precision.bfloat16
    imitates = config.imitation.keep > 0 and len(demos) > 0
    optimiser = build_optimiser(parts)
    clip = clip_each if config.optimiser.clip_each else clip_grad_norm_
    env = build_env(parts)
    agents = env.reset()
    meter = EpisodeMeter(len(world.goals))
    total = options.frames_per_scene * len(world.scenes)
    frames, seconds = 0, 0.0

    def losses(batch: TensorDictBase) -> TensorDictBase:
        rows = batch.select(*trunk.in_keys)
        if imitates:
            rows = torch.cat([rows, demos.select(*trunk.in_keys)])
        hidden = trunk(rows)["hidden"]
        result = objective(batch.set("hidden", hidden[: len(batch)]))
        return result.update(imitation(demos.copy().set("hidden", hidden[len(batch) :]))) if imitates else result

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

    if run.saved is None:
        test(parts, run, frames)
    else:
        frames, seconds = run.saved["frames"], run.saved["training_seconds"]
        network.load_state_dict(run.saved["learning"])
        optimiser.load_state_dict(run.saved["optimiser"])
        agents = TensorDict(run.saved["agents"], batch_size=env.batch_size, device=env.device)
        meter.load_state_dict(run.saved["meter"])
        restore_random_state(env, run.saved["random"])

    often = 0.2 if sys.stderr.isatty() else 10.0
    bar = tqdm(total=total, initial=frames, unit=" frames", unit_scale=True, mininterval=often, disable=total == 0)
    with interruptible() as interrupted, bar:
        while frames < total:
            began, before, left = time.perf_counter(), frames, 1 - frames / total
            for group in optimiser.param_groups:
                group["lr"] = config.optimiser.lr * left
            objective.entropy_coeff = options.final_entropy + (options.entropy - options.final_entropy) * left
            imitation.coeff = config.imitation.keep * left

            with network.encoder.remembering(), torch.autocast(env.device.type, torch.bfloat16, enabled=rounds):
                batch, agents = collect(env, operator, agents, options.steps)
                advantages(bootstrap(batch, critic))
                for part in passes(batch.reshape(-1), config.objective):
                    result = losses(part)
                    optimiser.zero_grad()
                    sum(value for key, value in result.items() if key.startswith("loss_")).backward()
                    clip(network.parameters(), config.optimiser.max_norm)
                    optimiser.step()

            frames += batch.numel()
            over = batch["next"].select("goal", "step_count").transpose(0, 1)[batch["next", "done"].squeeze(-1).T]
            meter.add(env.base_env.goal_index[over["goal"]], over["step_count"].squeeze(-1), frames)
            seconds += time.perf_counter() - began
            bar.update(batch.numel())
            bar.set_postfix_str(f"ATL {meter.atl:.1f}", refresh=False)
            if due(before, frames, total, ROWS):
                progress = {"frames": frames, "seconds": seconds, "frames_per_second": frames / seconds}
                progress |= {"atl": meter.atl, "atl_worst_goal": meter.worst_atl, "episodes": meter.episodes}
                values = {key: value.item() for key, value in sorted(result.items()) if value.numel() == 1}
                run.write("reinforcement", frames, progress | values)
            if due(before, frames, total, config.evaluation.times):
                test(parts, run, frames)
            if run.save_due() or interrupted or frames >= total:
                run.save(state())
            if interrupted and frames < total:
                bar.close()
                raise SystemExit(f"interrupted; go on with: python recipes/train.py resume={run.folder}")
    rate = frames / seconds if seconds else None
    return {"frames": frames, "frames_per_second": rate, "stable_at_frame": meter.stable_at}


def passes(batch: TensorDictBase, options: ObjectiveConfig) -> Iterator[TensorDictBase]:
    """The batches of the updates that follow one rollout: all of it, or shuffled shares of it."""
    for _ in range(options.epochs):
        if options.minibatches == 1:
            yield batch
        else:
            yield from (batch[rows] for rows in torch.randperm(len(batch)).chunk(options.minibatches))


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


def draw_scene(parts: Parts, index: int, folder: Path, count: int = 5) -> None:
    """Pictures of a scene's first goal: greedy episodes, that of the farthest start as a GIF; maps of the policy."""
    world, scene = parts.world, parts.world.scenes[index]
    goal_index = int(torch.nonzero(world.scene_of[world.goals] == index)[0])
    distances = world.distances[goal_index]
    order = torch.argsort(distances, descending=True, stable=True)[: int((distances > 0).sum())]
    starts = order[torch.linspace(0, 0.9 * (len(order) - 1), min(count, len(order))).long()]
    episodes, paths = run_trajectories(parts, (torch.full_like(starts, goal_index), starts))
    goal = int(world.goals[goal_index]) - world.offsets[index]
    facts = describe(parts) | {"scene": scene.name, "source": scene.source}
    title = f"{run_title(facts)}, goal {goal}"
    walked = [[state - world.offsets[index] for state in path] for path in paths]
    success = episodes.success.tolist()
    draw_trajectories(scene, goal, walked, folder / f"trajectories_{scene.name}.png", success=success, title=title)
    write_gif(scene, goal, walked[0], folder / f"episode_{scene.name}.gif", title=title, success=success[0])
    matching = TemplateStop(parts.config.stop.threshold, parts.config.stop.match)
    probabilities, value = action_values(parts.network, world, parts.sight, goal_index)
    scores = matching.scores(world)[goal_index, world.scene_of == index]
    draw_policy(
        scene,
        goal,
        probabilities.cpu(),
        value.cpu(),
        scores.cpu(),
        folder / f"maps_{scene.name}.png",
        title=title,
        threshold=matching.threshold,
    )


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
        check_overrides(TrainConfig, sys.argv[1:])
    main()
