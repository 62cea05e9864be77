"""Use dirl from several threads of one program: nothing may fail, and the state of the process stays as it was.

    nice python tests/faults/threads.py calls=200

Four threads share a navigator, decode views and photographs, read tours and dumps, and step an environment each. It
prints a line for each; the exit status is 1 if a call raised an error, or changed what belongs to the whole process.
"""

import os
import signal
import tempfile
import warnings
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import gymnasium
import numpy as np
from campaign import start
from PIL import Image
from tours import written

from dirl import Navigator
from dirl.scenes import load_scenes
from dirl.scenes.views import read_photo
from dirl.sources.tours import read_tour
from dirl.sources.tours.images import cut_views


def tasks(folder):
    """What a thread does, by its name."""
    navigator = Navigator.load("general")
    images = np.random.default_rng(0).integers(0, 256, (4, 60, 80, 3), np.uint8)
    navigator.reset(images)
    Image.fromarray(images[0]).save(folder / "photo.png")
    views = load_scenes("bathroom_02")[0].views
    tour = written("pannellum", folder)

    def cut():
        image = read_tour(tour).panoramas[0].image
        return list(cut_views([image], np.zeros((1, 1)), size=(30, 40), field_of_view=90))

    def step():
        env = gymnasium.make("dirl/Navigation-v0", scene="bathroom_02")
        env.reset(seed=1)
        return [env.step(np.int64(action)) for action in (0, 1, 2, 3)]

    return {
        "Navigator.act": lambda: navigator.act(images),
        "views of a dump": lambda: [views[state] for state in range(5)],
        "photographs": lambda: read_photo(folder / "photo.png"),
        "tours": cut,
        "dumps": lambda: load_scenes("bathroom_02"),
        "environments": step,
    }


def state():
    """What belongs to the whole process."""
    handlers = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    return Image.MAX_IMAGE_PIXELS, [*warnings.filters], os.getcwd(), dict(os.environ), handlers, np.geterr()


def main(calls=200):
    """Try all; how many failed."""
    failed = 0
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(4) as threads:
        for name, task in tasks(Path(folder)).items():
            task()  # what is imported late may add filters of its own
            before = state()
            found = [threads.submit(task) for _ in range(calls)]
            errors = Counter(type(error).__name__ for one in found if (error := one.exception()))
            changed = state() != before
            failed += bool(errors or changed)
            print(f"{name}: {calls} calls, errors {dict(errors)}, the process {'CHANGED' if changed else 'as it was'}")
    return failed


if __name__ == "__main__":
    start(main)
