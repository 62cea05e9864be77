"""Measure the speed of training and evaluation on this machine, everything in one run.

    python benchmarks/benchmark.py out=benchmark.json
    python benchmarks/benchmark.py worlds=[kitchen_02] growth=false "train=['reinforcement.agents_per_scene=400']"

Training is ``reinforce`` of recipes/train.py as it is. Beside it stand the loops of benchmarks/loops.py: bare tensors,
stock TorchRL, Stable-Baselines3. All take turns, so that what else the machine does hits all; medians are shown. The
limit is the rate of the machine's float32 matrix products. All options: conf/benchmark.yaml.
"""

import multiprocessing
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import hydra
import torch
from hydra import compose, initialize_config_dir
from loops import bare_tensors, stable_baselines3, stock_torchrl
from omegaconf import DictConfig
from torch.utils.flop_counter import FlopCounterMode
from tqdm import tqdm
from train import imitate, peak_memory_mb, reinforce

from dirl.config.command_line import check_overrides, one_line_errors, register
from dirl.config.schemas import BenchmarkConfig, ConfigError, TrainConfig, typed
from dirl.models import actor_critic
from dirl.runs.folder import Run, write_json
from dirl.scenes import load_scenes, write_dump
from dirl.training.build import Parts, build_env, learning_parts, run_policy
from dirl.training.rollout import collect

CONF = Path(__file__).resolve().parent.parent / "conf"
SLOW = 20
"""The loops of others make so many times fewer updates than ours."""

GROWTH = {
    "agents": [16, 64, 256, 1024, 4096],
    "scenes": [1, 4, 16, 64],
    "goals": [4, 32, 128, 512],
}


@hydra.main(version_base="1.3", config_path="../conf", config_name="benchmark")
def main(composed: DictConfig) -> None:
    """Measure, print the tables, write the file."""
    with one_line_errors():
        options: BenchmarkConfig = typed(composed)
        if options.out is not None and Path(options.out).exists():
            raise ConfigError(f"out={options.out}: there is such a file already; it is not overwritten")
        fixed = [f"reinforcement.frames_per_scene={options.frames_per_scene}", *options.train]
        asked = [train_config([f"scene={_text(scene)}", *fixed]) for scene in options.worlds]
        for config in asked:
            learning_parts(config)
    result: dict[str, Any] = {"threads": torch.get_num_threads()}
    result["limits"] = {name: matrix_product_rate(getattr(torch, name)) for name in ("float32", "bfloat16")}
    result["growth"] = growth(options.train) if options.growth else []
    result["rows"] = [
        compare(_text(scene), config, options, result["limits"]["float32"])
        for scene, config in zip(options.worlds, asked, strict=True)
    ]
    result["peak_memory_mb"] = peak_memory_mb()
    print(tables(result))
    if options.out is not None:
        write_json(Path(options.out), result)


def train_config(overrides: Sequence[str]) -> TrainConfig:
    """A configuration of recipes/train.py in which nothing but training takes time."""
    quiet = ["evaluation.times=0", "checkpoint.every_seconds=1e9"]
    config: TrainConfig = typed(compose("train", [*quiet, *overrides]))
    return config


def compare(name: str, config: TrainConfig, options: BenchmarkConfig, limit: float) -> dict[str, Any]:
    """One row: our loop and the others in one world, and how long it takes to learn it."""
    scenes = len(learning_parts(config).world.scenes)
    updates = config.reinforcement.frames_per_scene // (
        config.reinforcement.agents_per_scene * config.reinforcement.steps
    )
    few = max(2, updates // SLOW)
    loops: dict[str, Callable[[], float]] = {
        "training": lambda: training(learning_parts(config)),
        "rollout": lambda: rollout(learning_parts(config), updates),
        "bare_tensors": lambda: bare_tensors(learning_parts(config), updates),
        "stock_torchrl": lambda: stock_torchrl(learning_parts(config), few),
    }
    if options.sb3:
        loops["stable_baselines3"] = lambda: stable_baselines3(learning_parts(config), few)
    rates: dict[str, list[float]] = {loop: [] for loop in loops}
    for _ in tqdm(range(options.repeats), desc=name, disable=not sys.stderr.isatty()):
        for loop, measure in loops.items():
            rates[loop].append(measure())
    needed = operations_per_frame(config)
    row: dict[str, Any] = {"world": name, "scenes": scenes, "operations_per_frame": needed}
    row["frames_per_second"] = {loop: statistics.median(of_loop) for loop, of_loop in rates.items()}
    row["times_faster"] = {
        loop: statistics.median(ours / other for ours, other in zip(rates["training"], of_loop, strict=True))
        for loop, of_loop in rates.items()
    }
    row["share_of_limit"] = row["frames_per_second"]["training"] * needed / limit
    row |= evaluation_seconds(learning_parts(config))
    return row | (learning(name, options) if options.learning else {})


def training(parts: Parts) -> float:
    """Frames per second of our training loop."""
    return float(trained(parts)["frames_per_second"])


def trained(parts: Parts, *, imitation: bool = False) -> dict[str, Any]:
    """Train in a folder that is thrown away."""
    with tempfile.TemporaryDirectory() as folder:
        run = Run(Path(folder), parts.config)
        run.begin(parts.world)
        torch.manual_seed(parts.config.seed)
        if imitation:
            imitate(parts, run, parts.demos)
        return reinforce(parts, run)


def rollout(parts: Parts, updates: int) -> float:
    """Frames per second of walking alone."""
    env, policy = build_env(parts), actor_critic(parts.network)
    agents, frames = env.reset(), 0
    began = time.perf_counter()
    for _ in range(updates):
        with parts.network.encoder.remembering():
            batch, agents = collect(env, policy, agents, parts.config.reinforcement.steps)
        frames += batch.numel()
    return frames / (time.perf_counter() - began)


def learning(name: str, options: BenchmarkConfig) -> dict[str, float]:
    """When a whole training became stable: at which frame, and after how many seconds (imitation included)."""
    config = train_config([f"scene={name}", *options.train])
    began = time.perf_counter()
    parts = learning_parts(config)
    result = trained(parts, imitation=True)
    seconds = time.perf_counter() - began
    stable, frames = result["stable_at_frame"], result["frames"]
    # All frames take about equally long.
    before = seconds - frames / result["frames_per_second"]
    return {"stable_at_frame": stable, "stable_at_second": stable and before + stable / result["frames_per_second"]}


def operations_per_frame(config: TrainConfig) -> float:
    """Floating-point operations of matrix products that our training loop makes for a frame."""
    parts = learning_parts(config)
    with FlopCounterMode(display=False) as counter:
        result = trained(parts)
    return float(counter.get_total_flops() / result["frames"])


def matrix_product_rate(dtype: torch.dtype, size: int = 2048, repeats: int = 10) -> float:
    """Operations per second of a matrix product, the median of several."""
    a, b = torch.randn(2, size, size).to(dtype)
    seconds = []
    for _ in range(repeats):
        began = time.perf_counter()
        a @ b
        seconds.append(time.perf_counter() - began)
    return 2 * size**3 / statistics.median(seconds)


def evaluation_seconds(parts: Parts) -> dict[str, Any]:
    """How long episodes take, with the network as it begins, which walks longest: every start, and 100,000 drawn."""
    draws = torch.randint(len(parts.starts[0]), (100_000,))
    many = Parts(**{**vars(parts), "starts": (parts.starts[0][draws], parts.starts[1][draws])})
    result: dict[str, Any] = {"episodes": len(parts.starts[0])}
    for name, of_parts, greedy in (("greedy_seconds", parts, True), ("sampled_100k_seconds", many, False)):
        began = time.perf_counter()
        run_policy(of_parts, greedy=greedy)
        result[name] = time.perf_counter() - began
    return result


def growth(overrides: list[str]) -> list[dict[str, Any]]:
    """Speed and memory over numbers of agents, scenes (copies of one) and goals, each in a process of its own."""
    rows = []
    cases = [(what, number) for what, numbers in GROWTH.items() for number in numbers]
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=spawn, max_tasks_per_child=1) as pool:
        for what, number in tqdm(cases, desc="growth", disable=not sys.stderr.isatty()):
            rows.append(pool.submit(grown, what, number, overrides).result())
    return rows


def grown(what: str, number: int, overrides: list[str], updates: int = 12) -> dict[str, Any]:
    """One row of `growth`: the built-in rooms with so many agents, the bathroom so many times, the kitchen's goals."""
    register()
    with tempfile.TemporaryDirectory() as folder, initialize_config_dir(str(CONF), version_base="1.3"):
        agents, scenes = 80, 1
        if what == "agents":
            scenes, agents = 4, number // 4
            world = ["scene=all"]
        elif what == "scenes":
            scenes, agents = number, max(1, 320 // number)
            (scene,) = load_scenes("bathroom_02")
            copies = [Path(folder) / f"copy_{copy}.h5" for copy in range(number)]
            for copy in copies:
                write_dump(copy, replace(scene, name=copy.stem, views=None))
            world = [f"scene=[{','.join(map(str, copies))}]"]
        else:
            agents = 320
            world = ["scene=kitchen_02", f"goals=[{','.join(map(str, range(number)))}]"]
        frames = updates * agents * 5
        counts = [f"reinforcement.frames_per_scene={frames}", f"reinforcement.agents_per_scene={agents}"]
        parts = learning_parts(train_config([*overrides, *world, *counts]))
        rate = training(parts)
    shape = {"agents": agents * scenes, "scenes": scenes, "states": len(parts.world), "goals": len(parts.world.goals)}
    return {**shape, "frames_per_second": rate, "peak_memory_mb": peak_memory_mb()}


def tables(result: dict[str, Any]) -> str:
    """The result for people, as Markdown."""
    limits = ", ".join(f"{name} {rate / 1e9:.0f} GFLOP/s" for name, rate in result["limits"].items())
    text = f"{result['threads']} threads; matrix products: {limits}; peak memory {result['peak_memory_mb']:.0f} MB\n\n"
    speeds: list[tuple[str, ...]] = []
    for row in result["rows"]:
        for loop, rate in row["frames_per_second"].items():
            cells = [row["world"], loop.replace("_", " "), f"{rate:,.0f}", f"{row['times_faster'][loop]:.2f}"]
            needed, share = f"{row['operations_per_frame'] / 1e6:.2f}", f"{row['share_of_limit']:.0%}"
            speeds.append((*cells, *((needed, share) if loop == "training" else ("", ""))))
    if speeds:
        columns = ("world", "loop", "frames/s", "training is x times it", "MFLOP a frame", "share of limit")
        text += markdown(columns, speeds)
    times: list[tuple[str, ...]] = []
    for row in result["rows"]:
        stable = row.get("stable_at_frame", 0)
        when = "never" if stable is None else f"frame {stable:,}, {row['stable_at_second']:.1f} s" if stable else ""
        greedy, sampled = f"{row['episodes']} in {row['greedy_seconds']:.2f} s", f"{row['sampled_100k_seconds']:.2f} s"
        times.append((row["world"], greedy, sampled, when))
    if times:
        text += "\n" + markdown(("world", "every start, greedy", "100,000 episodes, sampled", "stable at"), times)
    if result["growth"]:
        names = tuple(result["growth"][0])
        grown_rows = [tuple(f"{row[name]:,.0f}" for name in names) for row in result["growth"]]
        text += "\n" + markdown(tuple(name.replace("_", " ") for name in names), grown_rows)
    return text


def markdown(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    """A table."""
    lines = [head, tuple("---" if not place else "---:" for place in range(len(head))), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _text(scene: Any) -> str:
    return scene if isinstance(scene, str) else f"[{','.join(scene)}]"


if __name__ == "__main__":
    register()
    with one_line_errors():
        check_overrides(BenchmarkConfig, sys.argv[1:])
    main()
