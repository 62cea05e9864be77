"""The recipes as a user runs them, and a run that takes seconds."""

import subprocess
import sys
from pathlib import Path

from hydra import compose, initialize_config_dir
from rooms import grid_scene

from dirl.config.command_line import prepare, register
from dirl.config.schemas import TrainConfig, typed
from dirl.scenes import write_dump

ROOT = Path(__file__).parents[2]

TINY = [
    "seed=3",
    "encoder.width=32",
    "heads.width=32",
    "imitation.fraction=0.2",
    "reinforcement.frames_per_scene=600",
    "reinforcement.agents_per_scene=6",
    "evaluation.times=2",
    "evaluation.max_steps=50",
    "checkpoint.every_seconds=0",
]

SHORT = [*TINY, "imitation.max_steps=10"]
"""A run that is made hundreds of times, to be killed and spoilt."""


def recipe_command(name, *arguments):
    folder = "benchmarks" if name == "benchmark" else "recipes"
    return [sys.executable, str(ROOT / folder / f"{name}.py"), *map(str, arguments)]


def run_recipe(folder, name, *arguments):
    """Run a recipe in a folder; its exit status, what it printed, and its errors."""
    done = subprocess.run(
        recipe_command(name, *arguments), cwd=folder, capture_output=True, text=True, timeout=300, check=False
    )
    return done.returncode, done.stdout, done.stderr


def room_file(folder, **options):
    """A dump of a small room of 24 states with two goals, and more features than states, as built-in rooms have."""
    file = folder / "room.h5"
    write_dump(file, grid_scene(goals=(0, 13), feature_width=32, **options))
    return file


def train_config(*options):
    """The configuration that ``recipes/train.py`` gets from these options."""
    register()
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        return typed(compose("train", prepare(TrainConfig, options, ROOT / "conf")))
