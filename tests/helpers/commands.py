"""The recipes as a user runs them, and a run that takes seconds."""

import copy
import csv
import functools
import json
import multiprocessing
import os
import sys
import time
from multiprocessing.forkserver import ensure_running
from unittest.mock import patch

import torch
from forks import ROOT as ROOT
from forks import Child, as_new
from rooms import grid_scene

from dirl.cli.parsing import compose_training, parsed
from dirl.config.files import typed
from dirl.runs.checkpoints import load_checkpoint
from dirl.scenes import write_dump

TINY = ["seed=3", "encoder.width=32", "heads.width=32", "imitation.fraction=0.2", "imitation.max_steps=60"]
TINY += ["reinforcement.frames_per_scene=600", "reinforcement.agents_per_scene=6"]
TINY += ["evaluation.times=2", "evaluation.max_steps=50"]

SAVED = "checkpoint.every_seconds=0"
"""A checkpoint after every update, which takes a quarter of such a run: for those that are killed."""

SHORT = [*TINY, "imitation.max_steps=10", SAVED]
"""A run that is made hundreds of times, to be killed and spoilt."""


@functools.cache
def serve():
    """Start the server whose forks are recipes; the context by which others are forks of it too."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["warmed"])
    with patch.dict(os.environ, PYTHONPATH=os.pathsep.join(sys.path)):
        ensure_running()
    return context


def start_recipe(folder, name, *arguments):
    """Start a recipe in a folder, see `Child`; the pictures of a training are left empty."""
    serve()
    prepare = functools.partial(as_new, dict(os.environ), pictures=name != "train")
    return Child(folder, name, *arguments, prepare=prepare, method="forkserver")


def run_recipe(folder, name, *arguments):
    """Run a recipe in a folder, as `start_recipe`; its exit status, what it printed, and its errors."""
    ended = start_recipe(folder, name, *arguments).wait()
    return ended.status, ended.printed, ended.errors


def done(folder, name, *arguments):
    """Run a recipe, which must succeed; what it printed."""
    status, printed, errors = run_recipe(folder, name, *arguments)
    assert status == 0, errors
    return printed


def evaluated(run, *options):
    """Evaluate a run, which must succeed; what was printed, and the measures."""
    file = run.parent / "evaluated.json"
    file.unlink(missing_ok=True)
    printed = done(run.parent, "evaluate", f"checkpoint={run}", f"out={file}", *options)
    return printed, json.loads(file.read_text())


def summary_of(run):
    """The summary of a finished run."""
    return json.loads((run / "summary.json").read_text())


def rows_of(file):
    """The rows of a CSV file, texts by column."""
    with file.open(newline="") as lines:
        return list(csv.DictReader(lines))


def have_the_same_weights(*runs):
    """Whether two runs ended with equal networks."""
    ours, theirs = (load_checkpoint(run)["network"] for run in runs)
    return all(torch.equal(ours[name], theirs[name]) for name in ours)


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
