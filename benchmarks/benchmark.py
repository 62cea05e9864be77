"""Measure the speed of training and evaluation on this machine, everything in one run.

    python benchmarks/benchmark.py out=benchmark.json
    python benchmarks/benchmark.py 'worlds=[kitchen_02]' growth=false "train=['reinforcement.agents_per_scene=400']"

Training is ``reinforce`` of recipes/train.py unchanged, see benchmarks/ours.py. It is compared with the loops of
benchmarks/loops.py: bare tensors, stock TorchRL, Stable-Baselines3. All run alternately, so that other load on the
machine affects all; medians are shown. The limit is the machine's throughput of float32 matrix products. All options:
conf/benchmark.yaml.
"""

from dirl.cli.start import start

if __name__ == "__main__":
    start("benchmark")  # answers help and refuses options, before the imports below take their time

import statistics
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import hydra
import torch
from growth import growth
from loops import bare_tensors, stable_baselines3, stock_torchrl
from omegaconf import DictConfig
from ours import evaluation_seconds, learning, operations_per_frame, peak_memory_mb, rollout, train_config, training
from tqdm import tqdm

from dirl.cli.command_line import one_line_errors
from dirl.config.components import check_components
from dirl.config.schemas import BenchmarkConfig, ConfigError, TrainConfig, typed
from dirl.scenes.io.atomic import write_json
from dirl.training.build import build_world

SLOW = 20
"""The loops of other libraries make so many times fewer updates than ours."""


SMALL = 256
"""Rows and columns of a small matrix."""


@hydra.main(version_base="1.3", config_path="../conf", config_name="benchmark")
def main(composed: DictConfig) -> None:
    """Measure, print the tables, write the file."""
    with one_line_errors():
        options: BenchmarkConfig = typed(composed)
        if options.out is not None and Path(options.out).exists():
            raise ConfigError(f"out={options.out}: this file exists already; it is not overwritten")
        fixed = [f"reinforcement.frames_per_scene={options.frames_per_scene}", *options.train]
        asked = [train_config([f"scene={_text(scene)}", *fixed]) for scene in options.worlds]
        for config in asked:
            check_components(config)
            build_world(config)
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


def compare(name: str, config: TrainConfig, options: BenchmarkConfig, limit: float) -> dict[str, Any]:
    """One row: our loop and the others in one world, and how long it takes to learn it."""
    scenes = len(build_world(config).scenes)
    updates = config.reinforcement.frames_per_scene // (
        config.reinforcement.agents_per_scene * config.reinforcement.n_steps
    )
    few = max(2, updates // SLOW)
    loops: dict[str, Callable[[], float]] = {
        "training": lambda: training(config),
        "rollout": lambda: rollout(config, updates),
        "bare_tensors": lambda: bare_tensors(config, updates),
        "stock_torchrl": lambda: stock_torchrl(config, few),
    }
    if options.sb3:
        loops["stable_baselines3"] = lambda: stable_baselines3(config, few)
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
    row |= evaluation_seconds(config)
    return row | (learning(train_config([f"scene={name}", *options.train])) if options.learning else {})


def matrix_product_rate(dtype: torch.dtype, size: int = 2048, repeats: int = 10) -> float:
    """Operations per second of a matrix product, the median of several; of small ones where large ones take seconds.

    Some processors have no instructions for bfloat16, and take a hundred times as long.
    """
    if size > SMALL and 2 * size**3 / (small := matrix_product_rate(dtype, SMALL, repeats)) > 1:
        return small
    a, b = torch.randn(2, size, size).to(dtype)
    seconds = []
    for _ in range(repeats):
        began = time.perf_counter()
        a @ b
        seconds.append(time.perf_counter() - began)
    return 2 * size**3 / statistics.median(seconds)


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
        columns = ("world", "loop", "frames/s", "training is x times it", "MFLOP a frame", "fraction of limit")
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
    main()
