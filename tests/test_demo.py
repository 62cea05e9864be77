"""The live demo of the site: its models against the agent in Python, and in headless Chromium the pages with photos."""

import io
import json
import re
import shutil
import sys
import threading
from base64 import b64decode
from dataclasses import replace
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest
import torch
from closet import dim_light
from commands import ROOT
from PIL import Image

from dirl.models import PlanningMemory
from dirl.scenes import load_scenes, write_dump
from dirl.scenes.graph import LEFT
from dirl.scenes.views import encoded_view

DOCS = ROOT / "docs"
MOST_BYTES = 16 * 10**6


@pytest.fixture(scope="module")
def demo():
    sys.path.insert(0, str(DOCS))
    try:
        import demo
    finally:
        sys.path.remove(str(DOCS))
    return demo


STATES = 40
"""Of the built-in room, which is cut off behind its first places."""


def part_of_a_room(folder):
    """The built-in room's dump and goals, as `demo.built_in_room` gives them, of its first states."""
    (scene,) = load_scenes("bathroom_02")
    arrays = {name: getattr(scene, name)[:STATES] for name in ("positions", "headings", "features")}
    graph = np.where(scene.graph < STATES, scene.graph, -1)[:STATES]
    views = [encoded_view(scene.views, state) for state in range(STATES)]
    write_dump(folder / "room.h5", replace(scene, graph=graph, **arrays, goals=(3,), patches=None, views=None), views)
    return folder / "room.h5", [*range(3, STATES, 9)]


@pytest.fixture(scope="module")
def site(demo, tmp_path_factory):
    """The folder of the demo, with a part of its room and a tour of two small rooms in a dim light."""
    if reason := demo.missing():
        pytest.skip(reason)
    base = tmp_path_factory.mktemp("site")
    folder, room = base / "demo", part_of_a_room(base)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(demo, "built_in_room", lambda: room)
        dim_light(patch)
        patch.setattr(demo, "TOUR", (("bathroom", "bathroom"), 3))
        patch.setattr(demo, "PANORAMA", (128, 256))
        try:
            demo.build(folder, DOCS / "_cache" / "demo_of_two_rooms")
        except RuntimeError as error:
            pytest.skip(str(error))
    return folder


@pytest.fixture(scope="module")
def address(site):
    """Where a server offers it."""

    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, *_):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(site)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}/"
    server.shutdown()
    server.server_close()


def data_of(site, name):
    text = (site / f"viewer_{name}.html").read_text()
    return [
        json.loads(re.search(rf'<script id="{part}" type="application/json">(.*?)</script>', text)[1])
        for part in ("data", "demo")
    ]


def test_page_and_models_are_small_and_without_npm_the_site_says_so(demo, site, tmp_path, monkeypatch):
    assert sum(file.stat().st_size for file in site.iterdir() if file.suffix != ".json") < MOST_BYTES
    monkeypatch.setattr(shutil, "which", lambda _: None)
    with pytest.raises(RuntimeError, match="npm is not installed"):
        demo.build(tmp_path / "demo", tmp_path / "cache")
    assert not (tmp_path / "demo").exists()


def planned(logits, stops, start, data, facts):
    """The actions of a walk by a policy's logits of each state and a `PlanningMemory`, as digits."""
    memory, state, actions, seen = PlanningMemory(), start, "", []
    walked = memory.begin(torch.tensor([4 if facts["quarter"] else 8]))
    while len(actions) < data["max_steps"] and not (actions and state in stops):
        around = data["surrounding"][state]
        same = torch.tensor([[node in facts["alike"][state] for node in seen]], dtype=torch.bool) & walked.used
        stop = torch.tensor([[view in stops for view in around]])
        walked = memory.arrive(walked, same, -logits[around].log_softmax(-1)[None], stop)
        walked.action = memory.plan(walked).argmax(1)
        seen += around
        actions += str(int(walked.action))
        after = data["graph"][state][int(walked.action)]
        state = state if after < 0 else after  # a blocked move
    return actions


@pytest.mark.parametrize("name", ["bathroom_02", "tour"])
def test_a_photo_is_a_goal(site, address, watched_tab, name):
    """A place's own view leads there as in Python; a photo taken beside a place is found; another one is told of."""
    data, facts = data_of(site, name)
    tab = watched_tab(f"{address}viewer_{name}.html", address)
    goal = data["goals"][2]
    start = int(np.argmax(goal["distances"]))
    view = io.BytesIO()
    picture = b64decode(data["views"][goal["state"]])
    Image.open(io.BytesIO(picture)).save(view, "PNG")
    tab.locator("#photo-said", has_text="The agent is ready").wait_for(timeout=120_000)  # loaded before the first photo
    tab.fill("#start", str(start))
    tab.press("#start", "Enter")
    tab.fill("#photo-threshold", "0.95")
    tab.set_input_files("#photo", {"name": "a.png", "mimeType": "image/png", "buffer": view.getvalue()})
    tab.locator("#photo-said", has_text="The view most like it").wait_for(timeout=120_000)
    assert f"state {goal['state']}, with a match of 1.00" in tab.inner_text("#photo-said")
    tab.press("body", "e")
    assert "this looks like the photo" in tab.inner_text("#outcome")
    assert int(tab.evaluate("document.body.dataset.state")) == goal["state"]
    # The last digits of the features, and so near ties of a plan, depend on the processor: its own logits count.
    logits, stops = (torch.tensor(tab.evaluate(f"[...goal.{name}]")) for name in ("logits", "stops"))
    logits, read = logits.view(-1, 4), np.frombuffer(b64decode(goal["logits"]), "<f4").reshape(-1, 4)
    chosen, lead = logits.argmax(1).numpy(), np.diff(np.sort(read, 1))[:, -1]
    other = chosen != read.argmax(1)
    assert other.mean() < 0.1
    assert lead[other].max(initial=0) < 0.25 * np.median(lead)
    taken = tab.evaluate("taken.slice(1).join('')")
    assert taken == planned(logits, stops.tolist(), start, data, facts)
    tab.fill("#photo-threshold", "0.85")
    tab.click("#photos button:nth-child(1)")
    tab.locator("#goal-title", has_text="your photo 2").wait_for(timeout=60_000)
    beside = data["graph"][tab.evaluate("goal.best")][LEFT]  # how far away it is found depends on near ties, too
    tab.fill("#start", str(beside))
    tab.press("#start", "Enter")
    tab.press("body", "e")
    assert "this looks like the photo" in tab.inner_text("#outcome")
    tab.set_input_files("#photo", {"name": "a.png", "mimeType": "image/png", "buffer": b"no picture"})
    tab.locator("#photo-said", has_text="That did not work").wait_for()
    tab.set_viewport_size({"width": 390, "height": 844})
    assert tab.evaluate("document.documentElement.scrollWidth") <= 390
