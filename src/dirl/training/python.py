"""Training and evaluation from Python, as the recipes do them: `dirl.train`."""

import importlib.util
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from operator import index
from pathlib import Path
from types import ModuleType
from typing import Any, overload

import numpy as np
from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig, open_dict
from PIL import Image

from dirl.agent.navigator import Navigator
from dirl.cli.parsing import compose_training, parse
from dirl.config.folders import HOME, RECIPES
from dirl.config.schemas import ConfigError
from dirl.reporting import summary_table
from dirl.reporting.sweeps import seed_table
from dirl.runs.checkpoints import Facts
from dirl.runs.folder import Run
from dirl.training.job import Components, run_job
from dirl.training.stacked import Job, run_together

PICTURES = {"learning_curve": "learning_curve.png", "paths": "trajectories_*.png", "maps": "maps_*.png"}
"""Of a run's folder, by what they show."""


class Measures(Facts):
    """What an evaluation measured, as ``summary.json`` has it; shown as a table, also in notebooks."""

    def __repr__(self) -> str:
        return summary_table(self)

    _repr_markdown_ = __repr__


@dataclass(frozen=True)
class TrainedRun:
    """A finished run: its folder, and what its summary says."""

    folder: Path
    summary: Measures

    def evaluate(self, *overrides: str, **options: object) -> Measures:
        """Evaluate its weights, by the options of ``recipes/evaluate.py``, as ``goals=[51]`` or ``max_steps=500``."""
        return evaluate(self.folder, *overrides, **options)

    def plot(self, what: str = "learning_curve") -> Image.Image:
        """Return a picture of it: ``learning_curve``; ``paths`` or ``maps`` of its first scene."""
        files = sorted(self.folder.glob(PICTURES[what])) if what in PICTURES else []
        if not files:
            drawn = [name for name, pattern in PICTURES.items() if any(self.folder.glob(pattern))]
            raise ValueError(f"{self.folder}: has no picture '{what}'; choose from {', '.join(drawn) or 'none'}")
        with Image.open(files[0]) as image:
            return image.convert("RGB")

    def navigator(self, **options: Any) -> Navigator:
        """Return its agent for camera images, see `dirl.Navigator.load`."""
        return Navigator.load(self.folder, **options)

    def __repr__(self) -> str:
        return f"{self.summary}\n\nfolder: {self.folder}"

    def _repr_markdown_(self) -> str:
        return f"{self.summary}\n\nfolder: `{self.folder}`"


class TrainedRuns(list[TrainedRun]):
    """Finished runs of several seeds; shown as a table of how they spread, also in notebooks."""

    def __repr__(self) -> str:
        return seed_table([run.summary for run in self])

    _repr_markdown_ = __repr__


@overload
def train(*overrides: str, seeds: None = None, **options: object) -> TrainedRun: ...
@overload
def train(*overrides: str, seeds: int | Sequence[int], **options: object) -> TrainedRuns: ...
def train(*overrides: str, seeds: int | Sequence[int] | None = None, **options: object) -> TrainedRun | TrainedRuns:
    """Train an agent, as ``dirl train`` does, and write the folder of its run.

    Args:
        overrides: options as on the command line, ``"preset=paper"`` or ``"imitation.fraction=0.1"``.
        seeds: a number of seeds, 0 and up, or these seeds: a run for each, returned as a list that is shown as a table.
        options: the same by name: ``scene="bathroom_02"``, ``seed=0``, ``out="first"`` for the folder; a mapping gives
            options of a group, ``imitation={"fraction": 0.1}``.

    Raises:
        ValueError: an option is wrong, or the run cannot be made; the message says why in one line.
        KeyboardInterrupt: it was interrupted; what is safe and how to go on has been printed.

    Example:
        >>> run = dirl.train(scene="bathroom_02", seed=0)  # doctest: +SKIP
        >>> run.evaluate(goals=[26])["greedy"]["spl"]  # doctest: +SKIP
    """
    if seeds is not None:
        return _train_seeds(overrides, chosen_seeds(seeds), options)
    arguments = [*overrides, *as_arguments(options)]
    composed, folder = _compose(arguments)
    runs: list[Run] = []

    def stages(run: Run, components: Components) -> Facts:
        runs.append(run)  # whose folder gets a number if another run has taken the same second
        return recipe("train").train(run, components)

    try:
        summary = run_job(composed, stages, folder, arguments)
    except SystemExit as error:
        if error.code != 130:
            raise
        raise KeyboardInterrupt from None
    return TrainedRun(runs[0].folder if runs else folder, Measures(summary))


def chosen_seeds(seeds: Any) -> list[int]:
    """Return so many seeds, 0 and up, or these; `ConfigError` if they are none, or one is there twice."""
    try:
        chosen = [*range(index(seeds))] if np.ndim(seeds) == 0 else [index(seed) for seed in seeds]
    except TypeError:
        chosen = []
    if not chosen or len(set(chosen)) < len(chosen):
        raise ConfigError(f"seeds={seeds}: must be a number of seeds, or a list of different ones")
    return chosen


def _train_seeds(overrides: Sequence[str], seeds: Sequence[int], options: Mapping[str, object]) -> TrainedRuns:
    """Train a run for each seed, as many of them as one program as can be, in folders of one folder."""
    jobs: list[Job] = []
    for seed in seeds:
        arguments = [*overrides, *as_arguments({**options, "seed": seed})]
        composed, folder = _compose(arguments)
        above = jobs[0].folder.parent if jobs else folder
        jobs.append(Job(composed, above / f"seed_{seed}", arguments))
    module = recipe("train")
    summaries = run_together(jobs, module.train, module.imitation, module.learn)
    runs = TrainedRuns()
    for job, summary in zip(jobs, summaries, strict=True):
        if isinstance(summary, Exception):
            raise summary
        runs.append(TrainedRun(job.folder, Measures(summary)))
    return runs


def _compose(arguments: Sequence[str]) -> tuple[DictConfig, Path]:
    """Return the configuration of a training and the folder of its run.

    Also inside another Hydra application, which gets its own state back.
    """
    state = GlobalHydra.instance()
    outer, state.hydra = state.hydra, None
    try:
        composed = compose_training(arguments, return_hydra_config=True)
        folder = Path(composed.hydra.run.dir)
        with open_dict(composed):
            del composed["hydra"]
    finally:
        GlobalHydra.instance().hydra = outer  # Hydra's own contexts replace the instance
    return composed, folder


def evaluate(checkpoint: str | Path, *overrides: str, **options: object) -> Measures:
    """Evaluate a run, a checkpoint or an agent of the package, as ``dirl evaluate`` does.

    Args:
        checkpoint: the folder of a run, a ``.pt`` file in one, or ``general``.
        overrides: options as on the command line.
        options: the same by name: ``scene="kitchen_02"``, ``goals=[51]``, ``max_steps=500``.

    Raises:
        ValueError: an option is wrong; the message says why in one line.
    """
    module = recipe("evaluate")
    arguments = [*as_arguments({"checkpoint": str(checkpoint)}), *overrides, *as_arguments(options)]
    return Measures(module.evaluate(parse(module.Options, arguments)))


@cache
def recipe(name: str) -> ModuleType:
    """Return a recipe as a module."""
    spec = importlib.util.spec_from_file_location(f"dirl_recipe_{name}", HOME / RECIPES[name][0])
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # where pickle and type hints look it up
    spec.loader.exec_module(module)
    return module


def as_arguments(options: Mapping[str, object], above: str = "") -> list[str]:
    """Return options as on the command line: ``{"imitation": {"rounds": 2}}`` is ``imitation.rounds=2``."""
    arguments = []
    for name, value in options.items():
        if isinstance(value, Mapping) and name != "goals":  # which are given by scene
            arguments += as_arguments(value, f"{above}{name}.")
        else:
            arguments.append(f"{above}{name}={_written(value)}")
    return arguments


def _written(value: object) -> str:
    """Return a value in Hydra's grammar, which is that of JSON but for the keys of mappings."""
    if isinstance(value, Mapping):
        return "{" + ",".join(f"{key}:{_written(each)}" for key, each in value.items()) + "}"
    return json.dumps(list(value) if isinstance(value, range) else value, ensure_ascii=False, default=str)
