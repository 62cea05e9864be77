"""The viewer's pages: what they hold, and in headless Chromium what they do."""

import base64
import copy
import json
import re
from dataclasses import replace

import numpy as np
import pytest
import torch
from parts import make_parts
from rooms import grid_scene
from tours import grid_truth, tour_of, turned
from train import imitate

from dirl.agent.decisions import observe
from dirl.agent.mapping import GraphMemory, GuidedPolicy
from dirl.envs import SurroundingViews
from dirl.evaluation.episodes import every_start
from dirl.evaluation.experts import ShortestPathPolicy
from dirl.evaluation.protocol import EvaluationProtocol
from dirl.perception.recognition.recogniser import TemplateStop
from dirl.reporting import viewer, viewer_pages
from dirl.runs.folder import Run
from dirl.scenes import load_scenes, make_world, write_dump
from dirl.scenes.views import encode
from dirl.sources.tours.conversion import tour_scene

LIMIT = 30


def answers(room, state, goal_index):
    """What the policy writes in states on the way to a goal."""
    observation, goals = room.protocol.observation, torch.full_like(state, goal_index)
    with torch.no_grad():
        return room.policy(observe(room.world, observation, state, observation.reset_view_ids(state), goals))


def path(room, goal_index, start):
    """The states of a greedy episode."""
    _, ((*states,),) = room.protocol.trajectories(room.policy, (torch.tensor([goal_index]), torch.tensor([start])))
    return states


def small_room(folder, *options, headings=4):
    """A small room with views, and an untrained network."""
    scene = grid_scene(4, 3, headings=headings, goals=(0, 13), blocked=[(1, 1)])
    file = folder / "room.h5"
    write_dump(file, scene, [encode(np.full((6, 8, 3), 5 * state % 256, np.uint8)) for state in range(len(scene))])
    limits = [f"evaluation.max_steps={LIMIT}", "encoder.width=64", "heads.width=64", "seed=1"]
    return make_parts(f"scene={file}", *limits, *options)


@pytest.fixture(scope="module")
def cloned(tmp_path_factory):
    """A small room whose policy was trained by imitation, so that it arrives."""
    folder = tmp_path_factory.mktemp("cloned")
    room = small_room(folder, "imitation.fraction=1")
    run = Run(folder, room.config)
    run.begin(room.world, room.observation.order)
    torch.manual_seed(0)
    imitate([run], room.policy, [room.demos])
    run.close()
    return room


def pages_of(room, **options):
    stop = TemplateStop(room.config.stop.threshold, room.config.stop.match)
    return viewer_pages(room.policy, room.protocol, matching=stop, title="a test", **options)


def data_of(page):
    return json.loads(re.search(r'<script id="data" type="application/json">(.*?)</script>', page, re.S)[1])


def floats(text):
    return torch.from_numpy(np.frombuffer(base64.b64decode(text), "<f4").copy())


def test_a_page_holds_the_networks_exact_answers_the_views_and_the_room(tmp_path):
    room = small_room(tmp_path)
    (page,) = pages_of(room).values()
    data, (scene,) = data_of(page), room.world.scenes
    states = torch.arange(len(room.world))
    scores = TemplateStop(0.9, "views").scores(room.world)
    for index, (goal, state) in enumerate(zip(data["goals"], (0, 13), strict=True)):
        answered = answers(room, states, index)
        assert (goal["state"], goal["stops"]) == (state, [state])
        torch.testing.assert_close(floats(goal["logits"]).view(-1, 4), answered["logits"], atol=1e-5, rtol=0)
        torch.testing.assert_close(floats(goal["values"]), answered["state_value"].squeeze(-1), atol=1e-5, rtol=0)
        assert torch.equal(floats(goal["scores"]), room.world.block(scores, index))
        assert goal["distances"] == room.world.block(room.world.distances, index).tolist()
    assert base64.b64decode(data["views"][7]) == scene.views.stored(7)
    assert data["graph"] == scene.graph.tolist()
    assert data["surrounding"] == scene.surrounding.tolist()
    assert data["directions"][:4] == [[0, 1], [1, 0], [0, -1], [-1, 0]]
    assert "default-src 'none'" in page  # it asks nothing of any other host
    assert set(re.findall(r"https?://[^\s\"']+", page)) == {"http://www.w3.org/2000/svg"}
    assert not re.search(r"\{\{\w+\}\}", page)


def test_where_a_memory_would_walk_very_many_episodes_some_goals_are_left_out(tmp_path, monkeypatch):
    monkeypatch.setattr(viewer, "MOST_WALKS", 50)
    room = small_room(tmp_path, "episodic_memory=planning")
    (page,) = pages_of(room).values()
    (goal,) = data_of(page)["goals"]  # of two
    assert goal["state"] == 0
    assert sum(walk is not None for walk in goal["walks"][0]) == len(room.world) - 1


def test_several_scenes_get_a_page_each_which_name_each_other(tmp_path):
    first, second = (grid_scene(3, depth, name=name, goals=(0, 5)) for depth, name in ((2, "a"), (3, "b")))
    for scene in (first, second):
        write_dump(tmp_path / f"{scene.name}.h5", scene)
    pages = pages_of(make_parts(f"scene=[{tmp_path / 'a.h5'},{tmp_path / 'b.h5'}]", "encoder.width=16"))
    assert list(pages) == ["viewer_a.html", "viewer_b.html"]
    data = data_of(pages["viewer_b.html"])
    assert [scene["file"] for scene in data["scenes"]] == list(pages)
    assert [goal["distances"] for goal in data["goals"]] == second.distances[:, [0, 5]].T.tolist()
    assert len(floats(data["goals"][0]["scores"])) == len(second)


def test_raw_views_are_encoded_and_a_room_without_views_has_none(dump):
    options = f"scene={dump}", "encoder.width=32", "goals=[0]"
    (page,) = pages_of(make_parts(*options)).values()
    assert base64.b64decode(data_of(page)["views"][0])[8:12] == b"WEBP"
    write_dump(dump, grid_scene())
    (page,) = pages_of(make_parts(*options)).values()
    assert data_of(page)["views"] is None


def test_a_scenes_name_can_neither_leave_its_script_nor_the_folder(tmp_path):
    name = "</script><img src=x>/../é"
    room = small_room(tmp_path)
    scene = copy.copy(room.world.scenes[0])
    object.__setattr__(scene, "name", name)  # no scene may have it
    room.protocol = replace(room.protocol, world=replace(room.world, scenes=(scene,)))
    ((file, page),) = pages_of(room).items()
    assert "/" not in file
    assert "<img" not in page
    assert data_of(page)["scene"] == name


def test_what_a_page_cannot_show_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"observation=sequential.*leave out viewer=true"):
        pages_of(small_room(tmp_path, "observation=sequential"))
    other = small_room(tmp_path).protocol
    with pytest.raises(ValueError, match="beside=other: is evaluated in other scenes or for other goals"):
        pages_of(make_parts("scene=bathroom_02", "encoder.width=16"), beside={"other": (0, other)})


@pytest.fixture
def open_page(watched_tab, tmp_path):
    """Open the one page of a room from its file."""

    def opened(pages, address=""):
        ((name, text),) = pages.items()
        (tmp_path / name).write_text(text, encoding="utf-8")
        return watched_tab((tmp_path / name).as_uri() + address, (tmp_path / name).as_uri())

    return opened


def shown(tab):
    """The step and state that the page shows."""
    return tuple(int(tab.evaluate(f"document.body.dataset.{name}")) for name in ("step", "state"))


def choose(tab, goal_index, start):
    tab.select_option("#goal", index=goal_index)
    tab.fill("#start", str(start))
    tab.press("#start", "Enter")


def walked(tab):
    """The steps and states of the episode, pressed through."""
    seen = [shown(tab)]
    while tab.locator("#step").is_enabled():
        tab.press("body", "n")
        seen.append(shown(tab))
    return seen


@pytest.mark.parametrize(
    ("options", "headings", "ends"),
    [
        (["stop.threshold=0.02"], 4, {"Stopped", "False", "Failed:"}),
        (["goal_view=front", "episodic_memory=planning"], 4, {"Stopped"}),
        (["episodic_memory=planning"], 12, {"Stopped", "Failed:"}),
    ],
    ids=["false stops", "one photo and a memory", "a plan, turns of 30"],
)
def test_episodes_end_as_in_the_evaluation_from_every_start(tmp_path, open_page, options, headings, ends):
    room = small_room(tmp_path, *options, headings=headings)
    goal_index, start = every_start(room.world)
    episodes, paths = room.protocol.trajectories(room.policy, (goal_index, start))
    tab = open_page(pages_of(room))
    found = tab.evaluate(
        """cases => cases.map(([goal, start]) => {
            for (const [id, value] of [["goal", goal], ["start", start]]) {
                document.getElementById(id).value = value;
                document.getElementById(id).dispatchEvent(new Event("change"));
            }
            document.getElementById("end").click();
            const { step, state } = document.body.dataset;
            return [Number(step), Number(state), document.getElementById("outcome").textContent.split(" ")[0]];
        })""",
        torch.stack([goal_index, start], 1).tolist(),
    )
    expected = [
        [len(path) - 1, path[-1], "Stopped" if success else "False" if false_stop else "Failed:"]
        for path, success, false_stop in zip(paths, episodes.success, episodes.false_stop, strict=True)
    ]
    assert {end for _, _, end in expected} == ends
    assert found == expected


def test_an_agent_goes_on_from_where_it_was_led_as_if_it_began_there(tmp_path, open_page):
    room = small_room(tmp_path, "episodic_memory=planning")
    tab = open_page(pages_of(room))
    choose(tab, 1, 8)
    for key in "dad":
        tab.press("body", key)
    step, state = shown(tab)
    assert walked(tab) == [(step + done, at) for done, at in enumerate(path(room, 1, state))][: LIMIT - step + 1]


def test_two_agents_walk_side_by_side(tmp_path, cloned, open_page):
    other = small_room(tmp_path)
    tab = open_page(pages_of(cloned, beside={"untrained": (other.policy, other.protocol)}))
    choose(tab, 1, 8)
    assert not tab.is_visible("#seen-beside")
    tab.select_option("#beside", "untrained")
    tab.press("body", "e")
    assert "Stopped at the goal" in tab.inner_text("#outcome")
    step = shown(tab)[0]
    state = path(other, 1, 8)[step]
    assert tab.get_attribute("#views-beside .ahead img", "alt") == f"view ahead, of state {state}"
    assert tab.inner_text("#outcome-beside") == f"untrained: On the way: {step} steps"
    assert tab.locator("#map .agent").count() == 2
    tab.select_option("#beside", "shortest path")
    tab.press("body", "e")
    assert tab.inner_text("#outcome-beside").startswith("shortest path: Stopped at the goal")


def test_a_link_leads_to_what_was_shown(tmp_path, open_page):
    room = small_room(tmp_path, "episodic_memory=planning")
    tab = open_page(pages_of(room))
    choose(tab, 1, 8)
    tab.select_option("#agent", "without memory")
    tab.select_option("#beside", "shortest path")
    for key in "ndwnnb":
        tab.press("body", key)
    seen, texts = shown(tab), [tab.inner_text(f"#{name}") for name in ("outcome", "outcome-beside", "goal-title")]
    tab.wait_for_url("**step=4**")  # not written at every step
    tab = open_page(pages_of(room), tab.evaluate("location.hash"))
    assert shown(tab) == seen
    assert [tab.inner_text(f"#{name}") for name in ("outcome", "outcome-beside", "goal-title")] == texts
    assert tab.locator("#agent option:checked").inner_text() == "without memory"
    tab.evaluate("location.hash = '#goal=0&start=20&step=2'")
    tab.locator("body[data-step='2']").wait_for()
    assert "state 0" in tab.inner_text("#goal-title")
    for wrong in ("goal=7", "start=4.5", "step=x", "agent=9"):
        tab.evaluate(f"location.hash = '#{wrong}'")
        tab.locator("#note", has_text=f"{wrong.replace('=', ' ')}, which this page does not have").wait_for()


def test_an_episode_can_be_stepped_scrubbed_and_played(cloned, open_page):
    tab = open_page(pages_of(cloned))
    choose(tab, 1, 8)
    assert tab.locator("#actions .chosen").count() == 1
    seen = walked(tab)
    assert seen == list(enumerate(path(cloned, 1, 8)))
    assert not tab.is_visible("#actions")  # nothing is decided any more
    assert f"Stopped at the goal after {len(seen) - 1} steps" in tab.inner_text("#outcome")
    assert (tab.inner_text("#verdict"), tab.inner_text("#score")) == ("stop", "1.000")
    tab.press("body", "b")
    assert shown(tab) == seen[-2]
    tab.press("body", "r")
    assert shown(tab) == (0, 8)
    tab.select_option("#speed", "10")
    tab.press("body", " ")
    assert tab.inner_text("#play") == "Pause"
    tab.locator("#play:text-is('Play')").wait_for()
    assert shown(tab) == seen[-1]


def test_keys_walk_the_room_and_views_and_bars_follow(tmp_path, open_page):
    room = small_room(tmp_path)
    pages = pages_of(room)
    (scene,), (data,) = room.world.scenes, map(data_of, pages.values())
    tab = open_page(pages)
    choose(tab, 0, 20)
    arrows, letters, state = ["ArrowUp", "ArrowRight", "ArrowLeft", "ArrowDown"], "wdas", 20
    for step, action in enumerate([1, 3, 0, 0, 2, 2, 0, 1, 3, 3, 3, 0], start=1):
        tab.press("body", (arrows if step % 2 else letters)[action])
        blocked = scene.graph[state, action] < 0
        state = state if blocked else int(scene.graph[state, action])
        assert shown(tab) == (step, state)
        assert ("blocked" in tab.inner_text("#outcome")) == bool(blocked)
        sources = [image.get_attribute("src") for image in tab.locator("#views img").all()]
        expected = [data["views"][scene.surrounding[state, column]] for column in (3, 0, 1, 2)]
        assert sources == [f"data:image/webp;base64,{view}" for view in expected]
    assert "12 by hand" in tab.inner_text("#outcome")
    choose(tab, 1, 8)
    answered = answers(room, torch.tensor([8]), 1)
    chances, value = (100 * answered["logits"].softmax(-1))[0].tolist(), answered["state_value"].item()
    bars = tab.locator("#actions .number").all_inner_texts()
    assert [float(text.rstrip("%")) for text in bars] == pytest.approx(chances, abs=0.06)
    assert float(tab.inner_text("#value").split()[-1]) == pytest.approx(value, abs=0.001)
    assert tab.evaluate("[...document.images].every((image) => !image.offsetParent || image.naturalWidth === 8)")


def tour_world(folder):
    """A laid-out tour of three by two places; from the second one leads a way to the first, and none back."""
    tour = tour_of(turned(grid_truth(3, 2), 0.5), dropped=[(0, 1)])
    scene = tour_scene(tour, headings=8, compare_images=False).scene
    rng = np.random.default_rng(0)
    features = rng.normal(size=(len(scene), 32)).astype(np.float32)
    views = [encode(rng.integers(0, 256, (6, 8, 3), np.uint8), quality=None) for _ in range(len(scene))]
    write_dump(folder / "tour.h5", replace(scene, features=features, goals=(len(scene) - 1,)), views)
    return make_world(load_scenes(str(folder / "tour.h5")))


def test_a_tour_is_drawn_and_walked(open_page, tmp_path):
    world = tour_world(tmp_path)
    memory = GraphMemory(world, 3.0)
    pages = viewer_pages(
        GuidedPolicy(ShortestPathPolicy(world), memory, 3),
        EvaluationProtocol(world, SurroundingViews(world, "front"), every_start(world), max_steps=60),
        matching=TemplateStop(0.95, "front"),
        title="a test",
        graphs=memory.graphs,
        last_steps=3,
    )
    tab = open_page(pages)
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
    choose(tab, 0, start)
    before = tab.evaluate(here)
    tab.press("body", "ArrowUp")
    assert shown(tab) == (1, moves[start])
    assert tab.evaluate(here) not in (before, -1)
    assert tab.locator("#nodes .here").count() == tab.locator("#nodes .goal-node").count() == 1
    tab.press("body", "e")
    assert "Stopped at the goal" in tab.inner_text("#outcome")
