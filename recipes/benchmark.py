"""Measure the speed of training and evaluation on this machine, everything in one run.

    python recipes/benchmark.py out=benchmark.json
    python recipes/benchmark.py 'worlds=[kitchen_02]' "train=['reinforcement.agents_per_scene=400']"

Training is ``reinforce`` of recipes/train.py unchanged. It is compared with stock TorchRL (`stock_torchrl` below). Both
run alternately, so that other load on the machine affects both; medians are shown. The limit is the machine's
throughput of float32 matrix products. All options: `Options` below.
"""

from dataclasses import dataclass
from typing import Any

from dirl.cli.start import new_file, run, start
from dirl.config.schemas import ConfigError, Frames, Positive, TrainConfig, option


@dataclass
class Options:
    """Measure the speed of training and evaluation on this machine."""

    worlds: list[Any] = option("scenes of recipes/train.py; what is measured in each", ["bathroom_02", "all"])
    frames_per_scene: Frames = option("how long each loop trains", 20_000)
    repeats: Positive = option("the loops take turns; medians are reported", 3)
    learning: bool = option("also train to the end, once: when is it stable?", True)
    train: list[str] = option("options of train.yaml, e.g. [reinforcement.agents_per_scene=400]", [])
    out: str | None = option("write the result to this file as JSON", None)


if __name__ == "__main__":
    options = start(__doc__, Options)  # "loading ...", or help; the imports below take their time

import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch.distributions import Categorical
from torch.nn.utils import clip_grad_norm_
from torch.utils.flop_counter import FlopCounterMode
from torchrl.collectors import Collector
from torchrl.envs import Compose, EnvBase, RewardScaling, StepCounter, TransformedEnv
from torchrl.modules import ActorValueOperator, ProbabilisticActor
from torchrl.objectives import A2CLoss
from torchrl.objectives.value import GAE
from tqdm import tqdm
from train import reinforce, train

from dirl.cli.parsing import compose_training
from dirl.config.components import check_components, make
from dirl.config.files import typed
from dirl.envs import NavigationEnv, Reward, SurroundingViews, ViewFeatures
from dirl.experiments.results import Table
from dirl.models import caching
from dirl.models.build import build_policy, feature_table
from dirl.runs.folder import Run, peak_memory_mb
from dirl.scenes.io.files import write_json
from dirl.training.build import build_world
from dirl.training.job import Components, build_components
from dirl.training.loops import TrainState
from dirl.training.objectives import trained_parameters
from dirl.training.rollout import collect

SLOW = 20
"""The loop of stock TorchRL makes so many times fewer updates than ours."""

SMALL = 256
"""Rows and columns of a small matrix."""


def main(options: Options) -> None:
    """Measure, print the tables, write the file."""
    out = None if options.out is None else new_file(options.out, ending="")
    fixed = [f"reinforcement.frames_per_scene={options.frames_per_scene}", *options.train]
    asked = [train_config([f"scene={_text(scene)}", *fixed]) for scene in options.worlds]
    for config in asked:
        check_components(config)
        build_world(config)
    result: dict[str, Any] = {"threads": torch.get_num_threads()}
    result["limits"] = {name: matrix_product_rate(getattr(torch, name)) for name in ("float32", "bfloat16")}
    result["rows"] = [
        compare(_text(scene), config, options, result["limits"]["float32"])
        for scene, config in zip(options.worlds, asked, strict=True)
    ]
    result["peak_memory_mb"] = peak_memory_mb()
    print(tables(result))
    if out is not None:
        write_json(out, result)


def compare(name: str, config: TrainConfig, options: Options, limit: float) -> dict[str, Any]:
    """One row: our loop and the others in one world, and how long it takes to learn it."""
    scenes = len(build_world(config).scenes)
    updates = config.reinforcement.frames_per_scene // (
        config.reinforcement.agents_per_scene * config.reinforcement.n_steps
    )
    few = max(2, updates // SLOW)
    loops: dict[str, Callable[[], float]] = {
        "training": lambda: float(trained(config)["frames_per_second"]),
        "rollout": lambda: rollout(config, updates),
        "stock_torchrl": lambda: stock_torchrl(config, few),
    }
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


def train_config(overrides: Sequence[str]) -> TrainConfig:
    """A configuration of recipes/train.py in which nothing but training takes time."""
    quiet = ["evaluation.times=0", "checkpoint.every_seconds=1e9"]
    config: TrainConfig = typed(compose_training([*quiet, *overrides]))
    return config


def made(config: TrainConfig, folder: str = "") -> tuple[Run, Components, TrainState]:
    """What training makes of a configuration; nothing is written yet."""
    run = Run(Path(folder), config)
    components = build_components(run)
    if components.state is None:
        raise ConfigError("train: these options train by no reinforcement, of which the speed is measured")
    return run, components, components.state


def trained(config: TrainConfig, *, imitation: bool = False) -> dict[str, Any]:
    """Train in a folder that is thrown away."""
    with tempfile.TemporaryDirectory() as folder:
        run, components, state = made(config, folder)
        protocol = components.protocol
        run.begin(protocol.world, protocol.observation.order)
        torch.manual_seed(config.seed)
        result = train(run, components) if imitation else reinforce(run, state, protocol)
        run.close()
        return result


def rollout(config: TrainConfig, updates: int) -> float:
    """Frames per second of walking alone."""
    _, components, state = made(config)
    operator, agents, frames = components.policy.operator(), state.agents, 0
    began = time.perf_counter()
    for _ in range(updates):
        with caching(components.policy, learns=True):
            batch, agents = collect(state.env, operator, agents, config.reinforcement.n_steps)
        frames += batch.numel()
    return frames / (time.perf_counter() - began)


def stock_torchrl(config: TrainConfig, updates: int) -> float:
    """Frames per second of TorchRL's A2C examples: collector, features as keys, GAE and loss with passes of their own.

    Its batches and network are ours; there is no imitation in it. The set-up is not counted.
    """
    options, world = config.reinforcement, build_world(config)
    agents, table = options.agents_per_scene * len(world.scenes), feature_table(config, world)
    network = build_policy(config, table, world.names, world=world)
    trunk = TensorDictSequential(
        TensorDictModule(network.encoder, ["observation", "goal_observation"], ["fused"]),
        TensorDictModule(network.heads.trunk, ["fused", "scene"], ["hidden"]),
    )
    actor = ProbabilisticActor(
        TensorDictModule(network.heads.policy, ["hidden", "scene"], ["logits"]),
        in_keys=["logits"],
        distribution_class=Categorical,
        return_log_prob=True,
    )
    critic = TensorDictModule(network.heads.value, ["hidden", "scene"], ["state_value"])
    operator = ActorValueOperator(trunk, actor, critic)
    policy, value = operator.get_policy_operator(), operator.get_value_operator()
    gae = GAE(gamma=options.gamma, lmbda=options.lmbda, value_network=value, deactivate_vmap=True)
    loss = A2CLoss(policy, value, entropy_coeff=options.entropy_coef.start, critic_coeff=options.critic_coef)
    optimiser = make("optimiser", config.optimiser, config.trust, params=trained_parameters(loss))

    def make_env() -> EnvBase:
        reward = Reward(config.reward.goal, config.reward.step, config.reward.collision)
        scaled = RewardScaling(loc=0.0, scale=config.reward.scale)
        seen = SurroundingViews(world), ViewFeatures(table.known)
        transforms = Compose(StepCounter(options.max_steps), scaled, *seen)
        return TransformedEnv(NavigationEnv(world, agents, reward=reward), transforms)

    collector = Collector(
        make_env,
        policy,
        frames_per_batch=agents * options.n_steps,
        total_frames=agents * options.n_steps * (updates + 1),
        auto_register_policy_transforms=False,
    )
    began = 0.0
    for update, batch in enumerate(collector):
        if update == 1:  # the first one warms up
            began = time.perf_counter()
        with torch.no_grad():
            gae(batch)
        result = loss(batch.reshape(-1))
        optimiser.zero_grad()
        sum(value for key, value in result.items() if key.startswith("loss_")).backward()
        clip_grad_norm_(loss.parameters(), options.max_grad_norm)
        optimiser.step()
    collector.shutdown()
    return updates * agents * options.n_steps / (time.perf_counter() - began)


def learning(config: TrainConfig) -> dict[str, float]:
    """When a whole training became stable: at which frame, and after how many seconds (imitation included)."""
    began = time.perf_counter()
    result = trained(config, imitation=True)
    seconds = time.perf_counter() - began
    stable, frames = result["stable_at_frame"], result["frames"]
    # All frames take about equally long.
    before = seconds - frames / result["frames_per_second"]
    return {"stable_at_frame": stable, "stable_at_second": stable and before + stable / result["frames_per_second"]}


def operations_per_frame(config: TrainConfig) -> float:
    """Floating-point operations of matrix products that our training loop makes for a frame."""
    with FlopCounterMode(display=False) as counter:
        result = trained(config)
    return float(counter.get_total_flops() / result["frames"])


def evaluation_seconds(config: TrainConfig) -> dict[str, Any]:
    """How long episodes take, with the network as it begins, which walks longest: every start, and 100,000 sampled."""
    _, components, _ = made(config)
    policy, every = components.policy, components.protocol
    goal_index, start = every.starts
    draws = torch.randint(len(start), (100_000,))
    many = replace(every, starts=(goal_index[draws], start[draws]))
    result: dict[str, Any] = {"episodes": len(start)}
    for name, protocol, greedy in (("greedy_seconds", every, True), ("sampled_100k_seconds", many, False)):
        began = time.perf_counter()
        protocol.run(policy, greedy=greedy)
        result[name] = time.perf_counter() - began
    return result


def tables(result: dict[str, Any]) -> str:
    """The result for people, as Markdown."""
    limits = ", ".join(f"{name} {rate / 1e9:.0f} GFLOP/s" for name, rate in result["limits"].items())
    text = f"{result['threads']} threads; matrix products: {limits}; peak memory {result['peak_memory_mb']:.0f} MB\n\n"
    speeds = Table({"world": "", "loop": "", "frames/s": ",.0f", "training is x times it": ".2f"})
    speeds.columns |= {"MFLOP a frame": ".2f", "fraction of limit": ".0%"}
    times = Table({"world": "", "every start, greedy": "", "100,000 episodes, sampled": "", "stable at": ""})
    for row in result["rows"]:
        for loop, rate in row["frames_per_second"].items():
            ours = (row["operations_per_frame"] / 1e6, row["share_of_limit"]) if loop == "training" else (None, None)
            speeds.add(row["world"], loop.replace("_", " "), rate, row["times_faster"][loop], *ours)
        stable = row.get("stable_at_frame", 0)
        when = "never" if stable is None else f"frame {stable:,}, {row['stable_at_second']:.1f} s" if stable else ""
        greedy, sampled = f"{row['episodes']} in {row['greedy_seconds']:.2f} s", f"{row['sampled_100k_seconds']:.2f} s"
        times.add(row["world"], greedy, sampled, when)
    return f"{text}{speeds.markdown()}\n\n{times.markdown()}\n"


def _text(scene: Any) -> str:
    return scene if isinstance(scene, str) else f"[{','.join(scene)}]"


if __name__ == "__main__":
    run(lambda: main(options))
