"""A room whose turns are 30 degrees, from training to every picture: a quarter turn is then three turns."""

import json
import re
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
import torch
from parts import make_parts, train_in
from PIL import Image
from policies import run_episodes
from rooms import grid_scene
from tours import grid_truth, tour_of, turned

from dirl.agent.mapping import GraphMemory
from dirl.agent.navigator import Navigator
from dirl.envs import SurroundingViews
from dirl.evaluation.episodes import every_start
from dirl.evaluation.experts import ShortestPathPolicy
from dirl.evaluation.protocol import EvaluationProtocol, metrics
from dirl.perception.recognition.build import matching
from dirl.perception.recognition.matching import TemplateStop
from dirl.reporting import draw_scene, draw_scene_map, viewer_pages
from dirl.scenes import load_scenes, make_world, write_dump
from dirl.scenes.views import encode
from dirl.sources.tours.moves import tour_scene
from dirl.training.build import describe

GOAL = 19
"""In the second place, headed 210 degrees, along no axis."""


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """DIRL trained in three places of twelve headings, and where its run lies."""
    folder = tmp_path_factory.mktemp("turns")
    room = grid_scene(2, 2, headings=12, goals=(GOAL,), blocked=[(0, 1)], feature_width=32)
    rng = np.random.default_rng(0)
    views = [encode(rng.integers(0, 256, (6, 8, 3), np.uint8), quality=None) for _ in range(len(room))]
    write_dump(folder / "room.h5", room, views)
    sizes = ["reinforcement.frames_per_scene=30_000", "reinforcement.agents_per_scene=30", "evaluation.times=0"]
    options = ["encoder.width=64", "heads.width=64", "imitation.fraction=0.6", "optimiser.lr=2e-3"]
    parts = make_parts(f"scene={folder / 'room.h5'}", *sizes, *options, "checkpoint.every_seconds=1e9")
    train_in(folder, parts)
    return parts, folder


def test_it_finds_its_goal_from_everywhere_and_is_drawn(trained):
    parts, folder = trained
    result = metrics(parts.protocol.run(parts.policy))
    assert (result["sr"], result["episodes"]) == (1, 35)
    assert result["spl"] > 0.7
    headings = parts.world.scenes[0].headings
    assert ((headings[parts.world.surrounding] - headings[:, None]) % 360 == [0, 90, 180, 270]).all()
    assert parts.observation.reset_view_ids(torch.tensor(GOAL)).tolist() == [19, 22, 13, 16]
    facts = describe(parts.config, parts.world)
    draw_scene(parts.policy, parts.protocol, 0, folder, matching=matching(parts.config, "cpu"), facts=facts)
    for name in ("maps_grid.png", "trajectories_grid.png", "episode_grid.gif"):
        with Image.open(folder / name) as image:
            assert min(image.size) > 200, name
            frames = getattr(image, "n_frames", 1)
    assert frames > int(parts.world.distances.max())  # the film begins farthest from the goal


def test_a_robot_and_gymnasium_walk_there(trained):
    parts, folder = trained
    scene = parts.world.scenes[0]
    known = {scene.views[state].tobytes(): torch.tensor(scene.features[state]) for state in range(len(scene))}
    navigator = Navigator.load(
        folder, lambda images: torch.stack([known[i.numpy().tobytes()] for i in images]), extractor=scene.extractor
    )
    env = gymnasium.make(
        "dirl/Navigation-v0", scene=str(folder / "room.h5"), observation="views", render_mode="rgb_array"
    )
    seen, info = env.reset(options={"state": 0}, seed=0)
    navigator.reset(seen["goal_views"])
    for _ in range(20):
        seen, _, arrived, _, info = env.step(navigator.act(seen["views"]).action)
        if arrived:
            break
    assert info["state"] == GOAL
    assert env.render().shape[0] == 300


@pytest.mark.parametrize("headings", [4, 12])
def test_a_tour_is_mapped_shown_and_walked(headings, tmp_path):
    """A graph that is no grid, on a laid-out map: in gymnasium, in the viewer, on a map, by a topological map."""
    truth = turned(grid_truth(3, 2), 0.5)
    leaning = [(i, j, heading + 10 * (i + j)) for i, j, heading in truth.links]
    made = tour_scene(tour_of(replace(truth, links=leaning)), headings=headings, tolerance=45, compare_images=False)
    rng = np.random.default_rng(0)
    states = len(made.scene)
    scene = replace(made.scene, features=rng.normal(size=(states, 32)).astype(np.float32), goals=(states - 1,))
    views = [encode(rng.integers(0, 256, (6, 8, 3), np.uint8), quality=None) for _ in range(states)]
    write_dump(tmp_path / "tour.h5", scene, views)
    env = gymnasium.make("dirl/Navigation-v0", scene=str(tmp_path / "tour.h5"), render_mode="rgb_array")
    env.reset(seed=0)
    assert env.render().shape[0] == 300
    scene = load_scenes(str(tmp_path / "tour.h5"))[0]
    draw_scene_map(scene, np.zeros(states, int), tmp_path / "map.png")
    world = make_world([scene])
    protocol = EvaluationProtocol(world, SurroundingViews(world), every_start(world), max_steps=60)
    shown = {"title": "a test", "matching": TemplateStop(0.9), "graphs": GraphMemory(world, 3.0).graphs}
    (page,) = viewer_pages(ShortestPathPolicy(world), protocol, **shown).values()
    data = json.loads(re.search(r'<script id="data" type="application/json">(.*?)</script>', page, re.S)[1])
    assert data["source"] == "tour, laid out"
    assert data["image_graph"]["places"] == 6
    found = np.array(data["image_graph"]["place"]).reshape(6, headings)
    assert (found == found[:, :1]).all()
    assert len(data["image_graph"]["links"]) >= 7  # of three by two places
    quarter = headings // 4
    assert data["surrounding"][0] == [0, quarter, 2 * quarter, 3 * quarter]
    turn = np.radians(360 / headings)
    first, second = np.array(data["directions"][:2])
    assert first @ second == pytest.approx(np.cos(turn), abs=1e-3)
    starts = every_start(world)
    found = run_episodes(GraphMemory(world, 3.0), world, starts, observation=SurroundingViews(world), max_steps=60)
    assert metrics(found)["sr"] == 1
