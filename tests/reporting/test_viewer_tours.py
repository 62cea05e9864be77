"""The viewer's page of a photographic tour in headless Chromium: links, topological map, one photo of the goal."""

from dataclasses import replace

import numpy as np
from tours import grid_truth, tour_of, turned

from dirl.agent.mapping import GraphMemory, GuidedPolicy
from dirl.envs import SurroundingViews
from dirl.evaluation.episodes import every_start
from dirl.evaluation.experts import ShortestPathPolicy
from dirl.evaluation.protocol import EvaluationProtocol
from dirl.perception.recognition.matching import TemplateStop
from dirl.reporting import viewer_pages
from dirl.scenes import load_scenes, make_world, write_dump
from dirl.scenes.views import encode
from dirl.sources.tours.moves import tour_scene


def tour_world(folder):
    """A laid-out tour of three by two places; from the second one leads a way to the first, and none back."""
    tour = tour_of(turned(grid_truth(3, 2), 0.5), dropped=[(0, 1)])
    scene = tour_scene(tour, headings=8, compare_images=False).scene
    rng = np.random.default_rng(0)
    features = rng.normal(size=(len(scene), 32)).astype(np.float32)
    views = [encode(rng.integers(0, 256, (6, 8, 3), np.uint8), quality=None) for _ in range(len(scene))]
    write_dump(folder / "tour.h5", replace(scene, features=features, goals=(len(scene) - 1,)), views)
    return make_world(load_scenes(str(folder / "tour.h5")))


def test_a_tour_is_drawn_and_walked(watched_tab, tmp_path):
    world = tour_world(tmp_path)
    memory = GraphMemory(world, 3.0)
    ((name, text),) = viewer_pages(
        GuidedPolicy(ShortestPathPolicy(world), memory, 3),
        EvaluationProtocol(world, SurroundingViews(world, "front"), every_start(world), max_steps=60),
        matching=TemplateStop(0.95, "front"),
        title="a test",
        graphs=memory.graphs,
        last_steps=3,
    ).items()
    (tmp_path / name).write_text(text, encoding="utf-8")
    tab = watched_tab((tmp_path / name).as_uri())
    assert tab.is_visible("#about-map")
    assert "known only by their links" in tab.inner_text("#about-map")
    assert tab.locator("#map line.link").count() == 7  # between three by two places, also where a way leads only back
    assert tab.locator("#map circle.cell").count() == 6
    assert tab.locator("#goal-views figure").count() == 1
    assert "one photo is all that the policy has" in tab.inner_text("#goal-title")
    led = "Led by the topological map of one walk; the greedy policy decides the last 3 steps, and where the map knows"
    assert led in tab.inner_text("#facts")
    assert tab.is_visible("#image-graph")
    assert tab.locator("#nodes circle.node").count() == 6
    here = """[...document.querySelectorAll("#nodes circle")].findIndex((node) => node.classList.contains("here"))"""
    moves = world.scenes[0].graph[:, 0]
    start = int(np.flatnonzero(moves >= 0)[0])
    tab.fill("#start", str(start))
    tab.press("#start", "Enter")
    before = tab.evaluate(here)
    tab.press("body", "ArrowUp")
    assert int(tab.evaluate("document.body.dataset.state")) == moves[start]
    assert tab.evaluate(here) not in (before, -1)
    assert tab.locator("#nodes .here").count() == tab.locator("#nodes .goal-node").count() == 1
    tab.press("body", "e")
    assert "Stopped at the goal" in tab.inner_text("#outcome")
