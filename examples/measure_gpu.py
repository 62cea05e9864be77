"""What stacks and CUDA graphs are worth on this machine's GPU: prints the table of docs/howto/gpu.md as it is measured.

    python examples/measure_gpu.py                                     # under four minutes on an H100
    python examples/measure_gpu.py device=cpu small=true seconds=600   # the same on a CPU, in miniature
    python examples/measure_gpu.py "parts=[12,13]" out=FOLDER          # some of `PARTS`; FOLDER gets what seeds learned

Parts that would not end within ``seconds`` are left out. Every row is printed when it is known.
"""

import contextlib
import copy
import importlib
import io
import json
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import torch

from dirl.cli.parsing import compose_training
from dirl.cli.start import run, start
from dirl.config.files import typed
from dirl.config.schemas import Device, option
from dirl.evaluation.protocol import metrics
from dirl.models import plain_weights
from dirl.runs.checkpoints import load_checkpoint
from dirl.training.job import build_components, prepare_device
from dirl.training.loops import updates
from dirl.training.stacked import Job, Stack, run_together

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "recipes"))
recipe = importlib.import_module("train")


@dataclass
class Options:
    """What are stacks and CUDA graphs worth on this machine's GPU?"""

    device: Device = option("", Device.cuda)
    seconds: float = option("parts that would not end within this time are left out", 225.0)
    small: bool = option("trainings in miniature", False)
    parts: list[int] | None = option("numbers of the parts to measure; null = all", None)
    out: str | None = option("a folder that gets what each of the seeds has learned", None)


def say(*columns):
    """Print a row of the table."""
    print(" | ".join(str(column) for column in columns), flush=True)


def run_recipe(*arguments):
    """Run a recipe as a user does; the lines of its standard error."""
    done = subprocess.run([sys.executable, *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(done.stderr[-1500:])
    return done.stderr.splitlines()


def command(*options):
    """A whole command as a user gives it: seconds in all, and the summary of its run."""
    folder = Path(tempfile.mkdtemp())
    began = time.perf_counter()
    told = run_recipe("recipes/train.py", *options, *SMALL, f"device={DEVICE}", f"hydra.run.dir={folder}/run")
    seconds = time.perf_counter() - began
    row("command", " ".join(options), [json.loads((folder / "run/summary.json").read_text())], seconds)
    for line in told:
        if "CUDA graph" in line:
            say(line)


def stack(count, *options):
    """So many seeds as one program, in this process; returns their weights."""
    count = min(count, 3) if SMALL else count
    jobs, folder = [], FOLDER / f"{len(list(FOLDER.iterdir()))}"
    given = [*options, *SMALL, f"device={DEVICE}", "evaluation.times=0"]
    composed = compose_training(given)
    for seed in range(count):
        composed.seed = seed
        jobs.append(Job(copy.deepcopy(composed), folder / str(seed), [*given, f"seed={seed}"]))
    began = time.perf_counter()
    if DEVICE == "cuda":
        torch.cuda.reset_peak_memory_stats()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()) as told:
        results = run_together(jobs, recipe.train, recipe.imitation, recipe.learn)
    graphs = {line for line in told.getvalue().splitlines() if "CUDA graph" in line}
    for result in results:
        if isinstance(result, Exception):
            raise result
    row(f"{count} seeds", " ".join(options), results, time.perf_counter() - began)
    for line in graphs:
        say(line)
    weights = [load_checkpoint(job.folder)["network"] for job in jobs]
    shutil.rmtree(folder)
    return weights


def seeds(count, *options, at_once=250):
    """How many of so many seeds fail: they are trained in stacks, and have no folders, which would take longer."""
    count, at_once = (3, 2) if SMALL else (count, at_once)
    composed = compose_training([*options, *SMALL, f"device={DEVICE}", "evaluation.times=0"])
    prepare_device(composed.device, composed.precision)
    found, needs = [], 0.0
    for first in range(0, count, at_once):
        began = time.perf_counter()
        if left() < needs:
            break
        runs, every = [], []
        for seed in range(first, min(first + at_once, count)):
            composed.seed = seed
            nothing = dict.fromkeys(("write", "save", "save_due"), lambda *_: None)
            runs.append(SimpleNamespace(config=typed(composed), saved=None, folder=FOLDER, **nothing))
            every.append(build_components(runs[-1], None, every[0] if every else None))
        stack, protocols = Stack(every), [own.protocol for own in every]
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            recipe.imitation(runs, every, stack)
            with updates(stack, runs, protocols) as loop:
                recipe.learn(stack, loop)
        walked = zip(every, stack.walked(protocols), strict=True)
        trained = [own.state.summary | {"greedy": metrics(protocol.run(own.policy))} for own, protocol in walked]
        found += trained
        needs = time.perf_counter() - began
        row(f"seeds {first} to {len(found) - 1}", " ".join(options), trained, needs)
    failed = sum(own["greedy"]["sr"] < 0.99 for own in found)
    say(f"{failed} of {len(found)} seeds have an SR below .99")
    if OPTIONS.out is not None:
        (Path(OPTIONS.out) / f"{'_'.join(['seeds', *options])}.json").write_text(json.dumps(found))


def left():
    """Seconds that are left."""
    return OPTIONS.seconds - (time.perf_counter() - BEGAN)


def same_seed(count, *options):
    """Whether two trainings with the same seeds end in the same weights."""
    pairs = zip(stack(count, *options), stack(count, *options), strict=True)
    equal = [all(torch.equal(value, other[name]) for name, value in one.items()) for one, other in pairs]
    say("same seed twice", " ".join(options), f"{sum(equal)} of {len(equal)} runs equal bit for bit")


class OneUpdate:
    """A loop of one update."""

    goes_on = True

    def record(self, reports):
        """Stop after the first."""
        self.goes_on = False


def first_update(*options):
    """How far the weights of two runs are from the CPU's after an update with the same rollout.

    On a CPU: those by two threads from those by one, whose principal axes are turned otherwise.
    """
    rollout, collect, weights = [], recipe.collect, []

    def collected(env, operator, agents, n_steps):
        if not rollout:
            rollout.append(collect(env, operator, agents, n_steps)[0])
        return rollout[0].clone().to(env.device), agents

    threads = torch.get_num_threads()
    for number, device in enumerate(("cpu", DEVICE), 1):
        torch.set_num_threads(number if DEVICE == "cpu" else threads)
        configs = [typed(compose_training([*options, f"device={device}", f"seed={seed}"])) for seed in range(2)]
        prepare_device(configs[0].device, configs[0].precision)
        members = [build_components(SimpleNamespace(config=config, saved=None)) for config in configs]
        recipe.collect = collected
        recipe.learn(Stack(members), OneUpdate())
        # As weights on features: the axes of the observations are each device's own.
        plain = [plain_weights(member.policy) for member in members]
        weights.append([own[name].float().cpu() for own in plain for name in own if name.endswith(("weight", "bias"))])
    recipe.collect = collect
    torch.set_num_threads(threads)
    torch.backends.cuda.matmul.allow_tf32 = False
    apart = torch.cat([(one - other).abs().flatten() for one, other in zip(*weights, strict=True)])
    beyond = (apart > 1e-5).float().mean()
    say(
        "first update",
        " ".join(options),
        f"at most {apart.max():.1e} from the CPU's weights, {beyond:.1e} of them beyond 1e-5",
    )


def row(kind, options, summaries, seconds):
    """What was measured: seconds in all, of which training; frames/s of all; SR and SPL, mean and lowest."""
    frames = sum(summary["frames"] for summary in summaries)
    training = summaries[0]["frames"] / summaries[0]["frames_per_second"]
    sr, spl = ([summary["greedy"][key] for summary in summaries] for key in ("sr", "spl"))
    stable = [summary["stable_at_frame"] for summary in summaries]
    known = sorted(at for at in stable if at is not None)
    memory = f"{torch.cuda.max_memory_allocated() / 2**30:.1f} GiB" if DEVICE == "cuda" else ""
    say(
        kind,
        options,
        f"{seconds:.1f} s in all",
        f"{training:.2f} s training",
        f"{frames / training:,.0f} frames/s",
        f"SR {statistics.mean(sr):.4f} (min {min(sr):.3f})",
        f"SPL {statistics.mean(spl):.4f} sd {statistics.pstdev(spl):.4f} (min {min(spl):.3f})",
        f"stable {len(known)}/{len(stable)}, median {known[len(known) // 2] if known else None}",
        memory,
    )


def grid(experiment, *options):
    """All jobs of an experiment of the paper as a user trains them, and its figure."""
    folder = Path(tempfile.mkdtemp(dir=FOLDER))
    began = time.perf_counter()
    given = [f"experiment={experiment}", f"device={DEVICE}", f"hydra.sweep.dir={folder}", *options, *SMALL]
    for arguments in (
        ["recipes/train.py", "-m", "hydra/launcher=stacked", *given],
        ["recipes/report.py", f"experiment={experiment}", f"runs={folder}", f"out={FOLDER}/report"],
    ):
        run_recipe(*arguments)
        seconds = time.perf_counter() - began
        runs = len(list(folder.glob("**/summary.json")))
        say(arguments[0], " ".join(arguments[1:3]), *options, f"{runs} runs", f"{seconds:.1f} s since its beginning")


PARTS = [  # about how many seconds each takes on an H100, and what it measures
    (8, lambda: first_update("scene=bathroom_02")),
    (5, lambda: same_seed(2, "scene=bathroom_02")),
    (11, lambda: command("scene=bathroom_02")),
    (20, lambda: command("scene=all")),
    (3, lambda: stack(1, "scene=bathroom_02")),
    (4, lambda: stack(1, "scene=all")),
    (6, lambda: stack(16, "scene=bathroom_02")),
    (18, lambda: stack(16, "scene=all")),
    (12, lambda: stack(16, "scene=all", "precision=tf32")),
    (52, lambda: stack(85, "scene=all", "precision=tf32")),
    (83, lambda: grid("fig8", "precision=tf32", *(["seed=0"] if SMALL else []))),
    (77, lambda: stack(85, "scene=all")),
    (32, lambda: seeds(250, "scene=bathroom_02", "precision=tf32")),
    (47, lambda: seeds(1000, "scene=bathroom_02")),  # the first stack; others follow as long as there is time
]


def main():
    """Print a row for each part."""
    if OPTIONS.out is not None:
        Path(OPTIONS.out).mkdir(parents=True, exist_ok=True)
    if DEVICE == "cuda":
        say(torch.cuda.get_device_name(), f"torch {torch.__version__}")
    for number in range(len(PARTS)) if OPTIONS.parts is None else OPTIONS.parts:
        needs, part = PARTS[number]
        if left() < needs:
            say(f"part {number}: left out, {left():.0f} s left")
            continue
        try:
            part()
        except Exception as error:
            say(f"part {number} failed: {type(error).__name__}: {str(error)[-1500:]}")
    say(f"{time.perf_counter() - BEGAN:.0f} s in all")


if __name__ == "__main__":
    OPTIONS = start(__doc__, Options)
    BEGAN = time.perf_counter()
    DEVICE = OPTIONS.device.value
    SMALL = ["reinforcement.frames_per_scene=1600", "imitation.max_steps=10"] if OPTIONS.small else []
    FOLDER = Path(tempfile.mkdtemp())
    run(main)
