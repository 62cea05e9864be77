"""Measure the speed of training and evaluation on this machine, everything in one run.

    python recipes/benchmark.py out=benchmark.json
    python recipes/benchmark.py scenes=[kitchen_02] "train=['reinforcement.agents_per_scene=400']"

Training is ``reinforce`` of recipes/train.py as it is. Beside it stands the same loop in bare tensors, without TorchRL
and TensorDict: what it is faster is what they cost. Both are also given as a share of the machine's limit, the rate of
its matrix products. All options: conf/benchmark.yaml.
"""

import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import hydra
import torch
import torch.nn.functional as F
from hydra import compose
from omegaconf import DictConfig
from torch.nn.utils import clip_grad_norm_
from torch.utils.flop_counter import FlopCounterMode
from tqdm import tqdm
from train import peak_memory_mb, reinforce

from dirl.assemble import Parts, build_optimiser, build_parts, run_policy
from dirl.commandline import check_overrides, one_line_errors, register
from dirl.config import BenchmarkConfig, ConfigError, typed
from dirl.evaluation import every_start
from dirl.runs import Run, write_json


@hydra.main(version_base="1.3", config_path="../conf", config_name="benchmark")
def main(composed: DictConfig) -> None:
    """Measure, print the table, write the file."""
    with one_line_errors():
        options: BenchmarkConfig = typed(composed)
        if options.out is not None and Path(options.out).exists():
            raise ConfigError(f"out={options.out}: there is such a file already; it is not overwritten")
        asked = [_train_config(scene, options) for scene in options.scenes]
        for config in asked:
            build_parts(config)
    loops: dict[str, Callable[[Parts], float]] = {"training": training, "bare tensors": bare_training}
    limit = matrix_product_rate()
    rows = []
    for scene, config in zip(options.scenes, asked, strict=True):
        rates: dict[str, list[float]] = {name: [] for name in loops}
        for _ in tqdm(range(options.repeats), desc=str(scene), disable=not sys.stderr.isatty()):
            for name, loop in loops.items():
                rates[name].append(loop(build_parts(config)))
        needed = operations_per_frame(build_parts(config))
        medians = {name: statistics.median(of_loop) for name, of_loop in rates.items()}
        rows.append(
            {
                "scene": scene,
                "frames_per_second": medians["training"],
                "bare_frames_per_second": medians["bare tensors"],
                "ratio": statistics.median(
                    a / b for a, b in zip(rates["training"], rates["bare tensors"], strict=True)
                ),
                "operations_per_frame": needed,
                "share_of_limit": medians["training"] * needed / limit,
                **evaluation_seconds(build_parts(config)),
            }
        )
    result = {"threads": torch.get_num_threads(), "matrix_products_per_second": limit, "rows": rows}
    result["peak_memory_mb"] = peak_memory_mb()
    print(table(result))
    if options.out is not None:
        write_json(Path(options.out), result)


def _train_config(scene: Any, options: BenchmarkConfig) -> Any:
    scene = scene if isinstance(scene, str) else f"[{','.join(scene)}]"
    fixed = [f"scene={scene}", f"reinforcement.frames_per_scene={options.frames_per_scene}"]
    return typed(compose("train", [*fixed, "evaluation.times=0", "checkpoint.every_seconds=1e9", *options.train]))


def training(parts: Parts) -> float:
    """Frames per second of our training loop."""
    with tempfile.TemporaryDirectory() as folder:
        run = Run(Path(folder), parts.config)
        run.begin(parts.world)
        return reinforce(parts, run)["frames_per_second"]


def bare_training(parts: Parts) -> float:
    """Frames per second of the same loop without TorchRL and TensorDict (A2C, surrounding views, stop at the goal).

    It makes the same computations in the same order, from the graph and the network alone.
    """
    config, world, network = parts.config, parts.world, parts.network
    options = config.reinforcement
    agents, steps, limit = options.agents_per_scene * len(world.scenes), options.steps, options.max_steps
    total = options.frames_per_scene * len(world.scenes)
    optimiser = build_optimiser(parts)
    demos = [parts.demos[key] for key in ("views", "goal_views", "scene")]
    goal_index, start = every_start(world)
    reward, scale = config.reward, config.reward.scale

    def begin() -> tuple[torch.Tensor, torch.Tensor]:
        chosen = torch.randint(len(start), (agents,))
        return start[chosen], goal_index[chosen]

    state, goal = begin()
    age = torch.zeros(agents, dtype=torch.long)
    began = time.perf_counter()
    for frames in range(0, total, agents * steps):
        left = 1 - frames / total
        for group in optimiser.param_groups:
            group["lr"] = config.optimiser.lr * left
        with network.encoder.remembering():
            seen, actions, rewards, values, next_values, overs, ends = [], [], [], [], [], [], []
            with torch.no_grad():
                for _ in range(steps):
                    seen.append((world.surrounding[state], world.surrounding[world.goals[goal]], world.scene_of[state]))
                    logits, value = network(*seen[-1])
                    actions.append(torch.multinomial(logits.softmax(-1), 1).squeeze(-1))
                    after = world.graph[state, actions[-1]]
                    arrived = after == world.goals[goal]
                    earned = torch.where(after == state, reward.collision, reward.step)
                    rewards.append(torch.where(arrived, reward.goal, earned) * scale)
                    values.append(value.squeeze(-1))
                    age += 1
                    over = arrived | (age >= limit)
                    cut = over & ~arrived
                    next_value = torch.zeros(agents)
                    if cut.any():
                        views = world.surrounding[after[cut]], world.surrounding[world.goals[goal[cut]]]
                        next_value[cut] = network(*views, world.scene_of[after[cut]])[1].squeeze(-1)
                    next_values.append(next_value)
                    overs.append(over)
                    ends.append(arrived)
                    fresh, fresh_goal = begin()
                    state, goal = torch.where(over, fresh, after), torch.where(over, fresh_goal, goal)
                    age[over] = 0
                views = world.surrounding[state], world.surrounding[world.goals[goal]]
                following = network(*views, world.scene_of[state])[1].squeeze(-1)
                advantage, advantages = torch.zeros(agents), list[torch.Tensor]()
                for t in reversed(range(steps)):
                    bootstrap = torch.where(overs[t], next_values[t], following)
                    delta = rewards[t] + options.gamma * bootstrap - values[t]
                    advantage = delta + options.gamma * options.lmbda * ~overs[t] * advantage
                    advantages.insert(0, advantage)
                    following = values[t]
            batch = [torch.cat(parts) for parts in zip(*seen, strict=True)]
            gains, targets = torch.cat(advantages), torch.cat(advantages) + torch.cat(values)
            rows = [torch.cat(pair) for pair in zip(batch, demos, strict=True)]
            logits, value = network(*rows)
            log_probs = logits.log_softmax(-1)
            own = log_probs[: len(gains)]
            taken = own.gather(-1, torch.cat(actions).unsqueeze(-1)).squeeze(-1)
            entropy = -(own.exp() * own).sum(-1).mean()
            loss = -(taken * gains).mean() - options.entropy * left * entropy
            loss = loss + options.value * F.mse_loss(value[: len(gains)].squeeze(-1), targets)
            loss = loss + config.imitation.keep * left * F.nll_loss(
                log_probs[len(gains) :], parts.demos["expert_action"]
            )
            optimiser.zero_grad()
            loss.backward()
            clip_grad_norm_(network.parameters(), config.optimiser.max_norm)
            optimiser.step()
    return total / (time.perf_counter() - began)


def operations_per_frame(parts: Parts) -> float:
    """Floating-point operations of matrix products that our training loop makes for a frame."""
    total = parts.config.reinforcement.frames_per_scene * len(parts.world.scenes)
    with FlopCounterMode(display=False) as counter:
        training(parts)
    return counter.get_total_flops() / total


def matrix_product_rate(size: int = 2048, repeats: int = 10) -> float:
    """The machine's limit: operations per second of a float32 matrix product, the median of several."""
    a, b = torch.randn(2, size, size)
    seconds = []
    for _ in range(repeats):
        began = time.perf_counter()
        a @ b
        seconds.append(time.perf_counter() - began)
    return 2 * size**3 / statistics.median(seconds)


def evaluation_seconds(parts: Parts) -> dict[str, float]:
    """How long one episode from every start takes, with the network as it begins: the longest episodes there are."""
    result: dict[str, float] = {"episodes": len(parts.starts[0])}
    for name, greedy in (("greedy_seconds", True), ("sampled_seconds", False)):
        began = time.perf_counter()
        run_policy(parts, greedy=greedy)
        result[name] = time.perf_counter() - began
    return result


def table(result: dict[str, Any]) -> str:
    """The result for people, as Markdown."""
    limit, memory = result["matrix_products_per_second"] / 1e9, result["peak_memory_mb"]
    lines = [
        f"{result['threads']} threads, float32 matrix products {limit:.0f} GFLOP/s, peak memory {memory:.0f} MB",
        "",
        "| scene | frames/s | bare tensors | ratio | MFLOP a frame | share of limit | every start, greedy | sampled |",
        "| ----- | -------: | -----------: | ----: | ------------: | -------------: | ------------------: | ------: |",
    ]
    for row in result["rows"]:
        cells = [
            str(row["scene"]),
            f"{row['frames_per_second']:,.0f}",
            f"{row['bare_frames_per_second']:,.0f}",
            f"{row['ratio']:.2f}",
            f"{row['operations_per_frame'] / 1e6:.2f}",
            f"{row['share_of_limit']:.0%}",
            f"{row['episodes']} in {row['greedy_seconds']:.2f} s",
            f"{row['sampled_seconds']:.2f} s",
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    register()
    with one_line_errors():
        check_overrides(BenchmarkConfig, sys.argv[1:])
    main()
