"""dirl from several threads of one program: nothing fails, and the state of the process stays as it was."""

import os
import signal
import warnings
from concurrent.futures import ThreadPoolExecutor

import gymnasium
import numpy as np
from PIL import Image
from tours import written

from dirl import Navigator
from dirl.scenes import load_scenes
from dirl.scenes.views import read_photo
from dirl.sources.tours import read_tour
from dirl.sources.tours.pixels import cut_views


def state():
    """What belongs to the whole process."""
    handlers = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    return Image.MAX_IMAGE_PIXELS, [*warnings.filters], os.getcwd(), dict(os.environ), handlers, np.geterr()


def test_four_threads_share_whatever_reads_and_decides(tmp_path):
    navigator = Navigator.load("general")
    images = np.random.default_rng(0).integers(0, 256, (4, 60, 80, 3), np.uint8)
    navigator.reset(images)
    Image.fromarray(images[0]).save(tmp_path / "photo.png")
    views = load_scenes("bathroom_02")[0].views
    tour = written("pannellum", tmp_path)

    def cut():
        image = read_tour(tour).panoramas[0].image
        return list(cut_views([image], np.zeros((1, 1)), size=(30, 40), field_of_view=90))

    def step():
        env = gymnasium.make("dirl/Navigation-v0", scene="bathroom_02")
        env.reset(seed=1)
        return [env.step(np.int64(action)) for action in (0, 1, 2, 3)]

    tasks = {
        "a navigator": lambda: navigator.act(images),
        "views of a dump": lambda: [views[state] for state in range(5)],
        "a photograph": lambda: read_photo(tmp_path / "photo.png"),
        "a tour": cut,
        "a dump": lambda: load_scenes("bathroom_02"),
        "environments": step,
    }
    with ThreadPoolExecutor(4) as threads:
        for name, task in tasks.items():
            task()  # what is imported late may add filters of its own
            before = state()
            for done in [threads.submit(task) for _ in range(20)]:
                done.result()
            assert state() == before, name
