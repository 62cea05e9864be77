"""What all tests share."""

import functools
import gc
import importlib
import os
import shutil
import tempfile
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = "1"  # here and in every program that a test starts: they are small, and side by side
os.environ["OMP_WAIT_POLICY"] = "PASSIVE"
if "PYTEST_XDIST_WORKER" not in os.environ:  # workers share it: what one of them has encoded the others read
    os.environ["XDG_CACHE_HOME"] = tempfile.mkdtemp(prefix="dirl-tests-")

import pytest
from forks import compose_once, reading_in_process
from hypothesis import settings

gc.disable()  # until the tests are collected: a million objects are made that stay

# The machine may be busy, so no example is timed; the same examples every time, so a red test stays red.
settings.register_profile("dirl", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("dirl")


QUICK = ("agent", "config", "envs", "evaluation", "models", "perception/recognition", "training")
"""Folders whose tests are run by ``pytest -m quick``, besides `test_layout.py`."""

SLOW = ("agent/test_navigator_encoders.py", "perception/recognition/test_learned.py")
"""What is left out of them: large networks are loaded, or a recogniser is trained."""

LONG = ("test_docs.py", "test_extend.py", "test_one_page.py", "test_platforms.py", "test_systems.py", "test_wheel.py")
"""Files with tests of many seconds, which come early: at the end the other worker would wait for them."""


def pytest_collection_modifyitems(config, items):
    """Mark the quick tests; begin with those of a site, so that the worker that builds it does them all."""
    items.sort(key=lambda item: ("site" not in item.fixturenames, item.path.name not in LONG))
    for item in items:
        inside = item.path.relative_to(Path(__file__).parent).as_posix()
        if (inside.startswith(QUICK) and inside not in SLOW) or inside == "test_layout.py":
            item.add_marker("quick")


def pytest_collection_finish():
    """Collect garbage again, but not in what the imports made, and not after every 700 objects."""
    gc.freeze()
    gc.set_threshold(20_000, 20)
    gc.enable()


ISOLATED = ("scenes", "faults")
"""Folders whose tests read dumps as a user does, each in a process of its own."""


@pytest.fixture(autouse=True, scope="module")
def reading(request):
    """Elsewhere dumps are read in the process of the test, for which no other one is started."""
    if request.path.relative_to(Path(__file__).parent).parts[0] in ISOLATED:
        yield
    else:
        with reading_in_process():
            yield


@pytest.fixture(autouse=True, scope="session")
def composing():
    """Configurations are composed once, which takes a third of a short training."""
    with compose_once():
        yield


@pytest.fixture(autouse=True, scope="session")
def loading():
    """The networks that come with the package are read once, which takes a second each."""
    from dirl.perception.backbones import registry  # late: the process that deals out the tests need not import torch

    with pytest.MonkeyPatch.context() as patch:
        for name in ("shipped_backbone", "_resnet", "lite0_encoder"):
            patch.setattr(registry, name, functools.cache(getattr(registry, name)))
        yield


@pytest.fixture
def scene():
    """Six places in two rows of three, 24 states, goal 0."""
    from rooms import grid_scene

    return grid_scene()


@pytest.fixture
def world():
    """Rooms of 24 and 16 states, with goals 0, 13 and 33."""
    from rooms import grid_scene

    from dirl.scenes import make_world

    return make_world([grid_scene(name="a", goals=(0, 13)), grid_scene(2, 2, name="b", goals=(9,), seed=1)])


@pytest.fixture
def dump(tmp_path, scene):
    """The room of `scene` as a file in the published layout."""
    from rooms import published_dump

    return published_dump(tmp_path / "room.h5", scene)


@pytest.fixture(scope="session")
def sift():
    """The matcher of views that needs no learned weights; none is described twice."""
    pytest.importorskip("cv2")
    import numpy as np

    from dirl.perception.matching import Matcher

    matcher = Matcher("sift")
    describe = matcher._describe
    once = functools.cache(lambda pixels, shape: describe(np.frombuffer(pixels, np.uint8).reshape(shape)))
    matcher._describe = lambda view: once(view.tobytes(), view.shape)
    return matcher


@pytest.fixture(scope="session")
def browser():
    """Headless Chromium, as the system has it; where ``DIRL_NEEDS_BROWSER`` is set, as in CI, its lack is an error."""
    needed = os.environ.get("DIRL_NEEDS_BROWSER") == "1"
    program = shutil.which("chromium")
    if program is None:
        assert not needed, "chromium is not installed"
        pytest.skip("chromium is not installed")
    if not needed:
        pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    playwright = importlib.import_module("playwright.sync_api")
    quiet = ["disable-quic", "no-first-run", "disable-background-networking", "disable-component-update"]
    allowed = "--allow-file-access-from-files"  # what a test lays out within a page of the site it may measure
    arguments = ["--no-sandbox", "--disable-gpu", "--disable-sync", allowed, *(f"--{name}" for name in quiet)]
    with playwright.sync_playwright() as started:
        launched = started.chromium.launch(executable_path=program, args=arguments)
        yield launched
        launched.close()


@pytest.fixture
def watched_tab(browser):
    """Open an address in a tab; whatever goes wrong in it, or asks for a thing of another host, fails the test.

    A page may ask for itself and for data in it; for files too where they lie within a folder that is named.
    """
    wrong, tabs = [], []

    def opened(address, within=None):
        inside = ("data:", within or address)
        tab = browser.new_page()
        tabs.append(tab)
        tab.on("console", lambda message: wrong.append(message.text))
        tab.on("pageerror", lambda error: wrong.append(str(error)))
        tab.on("request", lambda asked: None if asked.url.startswith(inside) else wrong.append(asked.url))
        tab.goto(address)
        return tab

    yield opened
    for tab in tabs:
        tab.close()
    assert not wrong
