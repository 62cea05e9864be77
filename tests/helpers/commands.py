"""The recipes as a user runs them, and a run that takes seconds."""

import copy
import functools
import time

from fork_server import Started as start_recipe
from forks import ROOT as ROOT
from rooms import grid_scene

from dirl.cli.parsing import compose_training, parsed
from dirl.config.files import typed
from dirl.scenes import write_dump

TINY = [
    "seed=3",
    "encoder.width=32",
    "heads.width=32",
    "imitation.fraction=0.2",
    "imitation.max_steps=60",
    "reinforcement.frames_per_scene=600",
    "reinforcement.agents_per_scene=6",
    "evaluation.times=2",
    "evaluation.max_steps=50",
]

SAVED = "checkpoint.every_seconds=0"
"""A checkpoint after every update, which takes a quarter of such a run: for those that are killed."""

SHORT = [*TINY, "imitation.max_steps=10", SAVED]
"""A run that is made hundreds of times, to be killed and spoilt."""


def run_recipe(folder, name, *arguments):
    """Run a recipe in a folder, in a fork, as `start_recipe`; its exit status, what it printed, and its errors."""
    ended = start_recipe(folder, name, *arguments).wait()
    return ended.status, ended.printed, ended.errors


def done(folder, name, *arguments):
    """Run a recipe, which must succeed; what it printed."""
    status, printed, errors = run_recipe(folder, name, *arguments)
    assert status == 0, errors
    return printed


def wait_until(happens, patience=600):
    """Wait until a function says so; on a busy machine what takes a second may take minutes."""
    began = time.monotonic()
    while not happens():
        assert time.monotonic() - began < patience, "it did not happen"
        time.sleep(0.02)


def room_file(folder, **options):
    """A dump of a small room of 24 states with two goals, and more features than states, as built-in rooms have."""
    file = folder / "room.h5"
    write_dump(file, grid_scene(goals=(0, 13), feature_width=32, **options))
    return file


def train_config(*options):
    """The configuration that ``recipes/train.py`` gets from these options."""
    others = tuple(option for option in options if not option.startswith("scene="))
    composed = copy.deepcopy(_composed(others))
    for option in options:
        if option.startswith("scene="):
            composed.scene = parsed(option).value()
    return typed(composed)


@functools.cache
def _composed(options):
    """What Hydra makes of options without a scene, which are often asked for again."""
    return compose_training(options)
