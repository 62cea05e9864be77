import pickle
import warnings
from dataclasses import replace

import numpy as np
import pytest
import torch
from commands import train_config
from odds import Odds
from PIL import Image
from refusals import refused
from rooms import grid_scene
from shown_goals import images_of, look_up, rooms, trained, walk_until_stop

from dirl import Navigator
from dirl.agent.decisions import observe
from dirl.agent.navigator import UNRECOGNISED
from dirl.agent.onnx import export_onnx
from dirl.evaluation.episodes import every_start
from dirl.models import PlanningMemory
from dirl.perception.recognition import NCC, Learned, Thresholds
from dirl.perception.recognition.recogniser import TemplateStop
from dirl.runs.checkpoints import load_checkpoint, save_checkpoint
from dirl.scenes import Action, make_world
from dirl.scenes.graph import AHEAD
from dirl.training.build import build_protocol


def load(folder, world, **options):
    return Navigator.load(folder, look_up(world), extractor="random", **options)


@pytest.fixture(scope="module")
def world():
    return rooms()


@pytest.fixture(scope="module")
def run(tmp_path_factory, world):
    """The folder of a run with surrounding views."""
    folder = tmp_path_factory.mktemp("runs") / "run"
    trained(folder, world)
    return folder


FRONT, TOUR = "goal_view=front", "a panorama and the arrows of a tour"


@pytest.mark.parametrize(
    "options",
    [
        ["heads=shared"],
        ["memory=gru", "memory.hidden_size=20"],
        ["observation=sequential", "stop.match=front"],
        ["episodic_memory=planning", "episodic_memory.repeated=1"],
        [FRONT, "episodic_memory=planning", "episodic_memory.turn=0.3"],
        ["episodic_memory=planning", TOUR],
        [FRONT, "episodic_memory=localising"],
        [FRONT, "episodic_memory=localising", "+policy.locates=3"],
        ["episodic_memory=localising", "+policy.locates=3"],
    ],
    ids=str,
)
def test_a_navigator_walks_and_stops_as_the_evaluation_does(tmp_path, monkeypatch, options):
    """One goal after the other: what it remembers ends with the next reset."""
    remembers, tour = "episodic_memory" in "".join(options), TOUR in options
    if remembers:
        place = {"headings": 8, "goals": (9,), "blocked": [(0, 1)]} if tour else {"goals": (0, 13)}
        world, most = make_world([grid_scene(3, 2, **place)]), 25
    else:
        world, most = rooms(("grid", "other.room")), 12
        options = [*options, "stop.threshold=0.1"]  # for false stops among random features
    if "episodic_memory=localising" in options:
        for module in ("agent.loading", "training.build"):
            monkeypatch.setattr(f"dirl.{module}.build_recogniser", lambda *_: Odds())
    options = [option for option in options if option != TOUR]
    policy, seen = trained(tmp_path, world, *options)
    starts = tuple(part[::3] for part in every_start(world))
    protocol = build_protocol(train_config(*options, f"evaluation.max_steps={most}"), world, seen)
    protocol = replace(protocol, starts=starts, panorama=tour, arrows=tour)
    episodes, paths = protocol.trajectories(policy, starts)
    ended = episodes.success | episodes.false_stop
    assert remembers or (episodes.success.any() and episodes.false_stop.any() and not ended.all())
    around = torch.arange(len(world)) if "observation=sequential" in options else world.surrounding
    around = world.panoramas() if tour else around
    navigators = [
        load(tmp_path, world, turns=8 if tour else 4, scene=None if "heads=shared" in options else name)
        for name in world.names
    ]

    def act(state):
        return navigator.act(images_of(around[state]), possible=world.possible[around[state]] if tour else None)

    for episode, path in enumerate(paths):
        navigator, goal = navigators[world.scene_of[path[0]]], int(world.goals[starts[0][episode]])
        photo = FRONT in options or "stop.match=front" in options
        navigator.reset(images_of(goal if photo else world.surrounding[goal]))
        walked, stopped = walk_until_stop(act, world, path[0], most)
        assert walked == path
        assert stopped == bool(ended[episode])
        if "+policy.locates=3" in options:  # every visit tells where the goal lies
            assert navigator.agent.belief.visits == len(walked)


def test_memory_and_recogniser_of_a_navigator_can_be_chosen(run, tmp_path, world):
    own = tmp_path / "mine.yaml"
    own.write_text("{_target_: dirl.perception.recognition.NCC}\n")
    navigator = load(run, world, recogniser="learned", episodic_memory="planning")
    assert (type(navigator.recogniser), type(navigator.memory)) == (Learned, PlanningMemory)
    assert navigator.memory.threshold == navigator.recogniser.thresholds.memory
    navigator = load(run, world, recogniser=str(own))
    assert (type(navigator.recogniser), navigator.memory) == (NCC, None)


def test_a_photo_stops_above_a_threshold_of_its_own(run, world):
    navigator = load(run, world, episodic_memory="planning")
    navigator.recogniser.thresholds = Thresholds(0.9, 0.95, 0.95)
    for goal, threshold in ((0, 0.95), (world.surrounding[0], 0.9)):
        navigator.reset(images_of(goal))
        navigator.act(images_of(world.surrounding[5]))
        assert navigator._seen.threshold == threshold


def test_moves_that_are_possible_are_told_facing_each_view(run, world):
    navigator, views = load(run, world), images_of(world.surrounding[0])
    navigator.reset(images_of(world.surrounding[3]))
    turns_right = np.tile([False, True, False, False], (4, 1))
    assert navigator.act(views, possible=turns_right).action == 1
    told = r"^possible: expected bool \[4, 4\], found int64 \[4, 4\]$"
    refused(told, navigator.act, views, possible=turns_right.astype(int))


def test_who_sees_a_panorama_gives_the_images_of_all_headings_at_each_step(tmp_path):
    world = make_world([grid_scene(2, 2, headings=8, goals=(3,))])
    trained(tmp_path, world, "episodic_memory=planning")
    navigator, around = load(tmp_path, world, turns=8), world.panoramas()
    navigator.reset(images_of(world.surrounding[3]))
    navigator.act(images_of(around[0]))
    refused(r"^images: 4 views after 8; call reset first$", navigator.act, images_of(world.surrounding[1]))
    refused(r"^images: expected uint8 .*, or a panorama's \[8, H, W, 3\] or", navigator.act, images_of(around[0, :6]))


@pytest.mark.parametrize("odds", [10.0, -12.0])
def test_points_of_a_photo_speak_for_or_against_a_panorama(odds, tmp_path, monkeypatch):
    class Points:
        enough = True

        def __init__(self, photo, field_of_view):
            assert (photo.ndim, field_of_view) == (3, pytest.approx(50, abs=1))

        def log_odds(self, seen, likeness):
            assert (len(seen), seen.field_of_view, likeness.argmax()) == (8, 90, 0)  # the photo is of the view ahead
            return torch.full((8,), -12.0).index_fill(0, torch.tensor(0), odds)

    world = make_world([grid_scene(2, 2, headings=8, goals=(3,))])
    monkeypatch.setattr("dirl.agent.loading.build_recogniser", lambda *_: Odds())
    monkeypatch.setattr("dirl.agent.navigator.PhotoPoints", Points)
    monkeypatch.setattr("dirl.agent.navigator.angle_of_views", lambda views: 90.0)
    trained(tmp_path, world, FRONT, "episodic_memory=localising")
    navigator, around = load(tmp_path, world, turns=8), world.panoramas()
    navigator.points = True  # as where XFeat is installed
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA405] = 43  # millimetres on film; images are 2x5
    file = tmp_path / "photo.webp"
    Image.fromarray(images_of(3)).save(file, exif=exif, lossless=True)
    for photo, angle in ((images_of(3), 50), (file, None)):
        navigator.reset(photo, field_of_view=angle)
        decision = navigator.act(images_of(around[3]))
        assert decision.stop == (odds > 0)
    for angle in (5, True, "50"):
        refused("^field_of_view=", navigator.reset, images_of(3), field_of_view=angle)
    navigator.field_of_view = 300.0
    refused("^field_of_view=300", navigator.reset, images_of(3))


@pytest.mark.parametrize(("view", "action"), [(0, 0), (4, 3)])
def test_points_of_four_views_tell_which_arrow_leads_to_the_goal_and_where_it_is(view, action, tmp_path, monkeypatch):
    class Bearing:
        def __init__(self, views):
            assert (len(views), views.field_of_view) == (4, next(angles))

        def clear(self, views):
            return torch.eye(len(views))[view]

    class Points(Bearing):
        def confirmed(self, odds, seen):
            return odds - told * (odds.shape[0] == len(seen))

    told, angles = 0.0, iter([75, 75, 90, 90])
    world = make_world([grid_scene(3, 3, headings=8, goals=(3,))])
    monkeypatch.setattr("dirl.agent.loading.build_recogniser", lambda *_: Odds())
    monkeypatch.setattr("dirl.agent.navigator.GoalBearing", Bearing)
    monkeypatch.setattr("dirl.agent.navigator.GoalPoints", Points)
    monkeypatch.setattr("dirl.agent.navigator.angle_of_views", lambda views: None)  # they share nothing
    trained(tmp_path, world, "episodic_memory=localising")
    navigator, around = load(tmp_path, world, turns=8), world.panoramas()[32]  # in the middle
    navigator.points = True  # as where XFeat is installed
    navigator.reset(images_of(world.surrounding[3]))
    assert navigator.act(images_of(around), possible=world.possible[around]).action == action
    assert navigator.act(images_of(world.panoramas()[3])).stop
    told, navigator.field_of_view = 99.0, 90.0
    navigator.reset(images_of(world.surrounding[3]))
    assert not navigator.act(images_of(world.panoramas()[3])).stop
    monkeypatch.setattr("dirl.agent.navigator.find_spec", lambda name: None)
    with pytest.warns(UserWarning, match=r"pip install 'dirl\[match\]'"):
        load(tmp_path, world, turns=8)


def test_the_middle_of_each_view_is_encoded_for_four_views_where_it_shows_something(tmp_path):
    def seen(states, width):
        return np.broadcast_to(images_of(states)[..., :1, :1, :], (*np.shape(states), 48, width, 3))

    def encoder(images):
        sizes.append((*images.shape[:3],))
        return look_up(world)(images)

    sizes: list[tuple[int, ...]] = []
    world = make_world([grid_scene(3, 3, headings=8, goals=(3,))])
    trained(tmp_path, world, "episodic_memory=planning")
    navigator, around = load(tmp_path, world, turns=8), world.panoramas()[0]  # in a corner
    navigator.encoder = encoder
    four, photo, arrows = world.surrounding[3], 3, int(world.possible[around][:, AHEAD].sum())
    assert 0 < arrows < 8
    for goal, width, middles in ((four, 100, [(arrows, 22, 48)]), (four, 60, []), (photo, 100, [])):
        navigator.reset(seen(goal, width))
        sizes.clear()
        navigator.act(seen(around, width), possible=world.possible[around])
        assert sizes == [(8, 48, width), *middles]


def test_that_nothing_is_recognised_for_long_is_said_once_a_walk(run, world, capsys):
    navigator = load(run, world, episodic_memory="planning")
    strange = iter(torch.randn(400, 16, generator=torch.Generator().manual_seed(0)))
    for walk in range(1, 3):
        navigator.encoder = look_up(world)
        navigator.reset(images_of(world.surrounding[0]))
        navigator.encoder = lambda images: torch.stack([next(strange) for _ in images])
        for _ in range(UNRECOGNISED + 3):
            navigator.act(images_of(world.surrounding[5]))
        told = capsys.readouterr().err.splitlines()
        assert len(told) == 1, walk
        assert told[0].startswith(f"warning: in {UNRECOGNISED} steps neither the goal nor any place seen before was")


@pytest.mark.parametrize("options", ["observation=surrounding", "observation=sequential", "episodic_memory=planning"])
def test_a_batch_decides_as_each_alone_and_torch_as_numpy(tmp_path, world, monkeypatch, options):
    """Each with a goal of its own; with a memory also where some agents are at new places and others at known ones."""
    recogniser = NCC()
    recogniser.thresholds = Thresholds(0.9, 0.95, 0.95)
    monkeypatch.setattr("dirl.agent.loading.build_recogniser", lambda *_: recogniser)
    trained(tmp_path, world, options)
    around = torch.arange(len(world)) if options == "observation=sequential" else world.surrounding
    together, goals, states = load(tmp_path, world), [0, 13, 21], torch.tensor([5, 13, 7])
    alone = [load(tmp_path, world) for _ in goals]
    together.reset(torch.from_numpy(images_of(around[goals]).copy()))
    for navigator, goal in zip(alone, goals, strict=True):
        navigator.reset(images_of(around[goal]))
    for step in range(12):
        both = together.act(torch.from_numpy(images_of(around[states]).copy()))
        for agent, navigator in enumerate(alone):
            action, stop, scores = navigator.act(images_of(around[states[agent]]))
            assert (type(action), type(stop), type(scores.matching)) == (Action, bool, float)
            assert (action, stop) == (both.action[agent].item(), both.stop[agent].item())
            assert scores.matching == pytest.approx(both.scores.matching[agent].item(), abs=1e-6)
            torch.testing.assert_close(scores.probabilities, both.scores.probabilities[agent])
        assert step or both.stop.tolist() == [False, True, False]
        states = world.graph[states, both.action]


def test_sampled_actions_come_as_often_as_their_probability_says(run, world):
    navigator = load(run, world)
    navigator.reset(images_of(world.surrounding[0]))
    images = images_of(world.surrounding[[9] * 2000])
    assert not images.flags.writeable
    assert torch.equal(navigator.act(images[..., ::-1]).action, navigator.act(images.copy()).action)  # flipped views
    draws = [navigator.act(images, sample=True, generator=torch.Generator().manual_seed(5)) for _ in range(2)]
    assert torch.equal(draws[0].action, draws[1].action)
    shares = torch.bincount(draws[0].action, minlength=4) / 2000
    torch.testing.assert_close(shares, draws[0].scores.probabilities[0], rtol=0, atol=0.04)
    assert (shares > 0.05).sum() > 1


def test_what_a_navigator_cannot_be_loaded_with_is_told(run, tmp_path, world):
    refused("another extractor: 'random', not 'CLIP'", Navigator.load, run, look_up(world), extractor="CLIP")
    refused(r"say which extractor .* trained with 'random'", Navigator.load, run, look_up(world))
    refused("^turns=6: expected an integer, as 4, 8 or 12$", load, run, world, turns=6)
    refused("^recogniser=other: choose from exact, learned, ncc, or a file", load, run, world, recogniser="other")
    refused(r"not trained in 'grod'; choose from \['grid'\]", load, run, world, scene="grod")
    saved = load_checkpoint(run)
    assert saved["views"] == ["ahead", "right", "back", "left"]
    save_checkpoint(tmp_path / "network.pt", {**saved, "views": ["ahead", "left", "back", "right"]})
    refused("trained on the views", load, tmp_path, world)
    other = {**saved["network"], "encoder.fusion.bias": torch.zeros(3)}
    save_checkpoint(tmp_path / "network.pt", {**saved, "network": other})
    refused("do not fit", load, tmp_path, world)


def test_images_features_and_numbers_of_agents_that_do_not_fit_are_refused(tmp_path, run, world):
    navigator, images = load(run, world), images_of(world.surrounding[0])
    told = r"returned torch.float32 \[4, 17\] for 4 images; .*\[4, 16\]: random"
    refused(told, load(run, rooms(width=17)).reset, images)
    nan = Navigator.load(run, lambda images: torch.full((len(images), 16), torch.nan), extractor="random")
    refused("not finite", nan.reset, images)
    for shape in ((3, 2, 5, 3), (4, 2, 5, 4), (0, 4, 2, 5, 3)):
        refused(r"goal_images: expected uint8 \[4, H, W, 3\] .*, found", navigator.reset, np.zeros(shape, np.uint8))
    for wrong, found in ((images / np.float32(255), "float32"), (list(images), "found list")):
        refused(found, navigator.reset, wrong)
    refused("call reset", navigator.act, images)
    navigator.reset(images_of(world.surrounding[[0, 13]]))
    refused("3 agents for 2 goals", navigator.act, images_of(world.surrounding[[1, 2, 3]]))
    trained(tmp_path, world, "observation=sequential")
    remembering = load(tmp_path, world)
    remembering.reset(images_of(0))
    remembering.act(images_of([1, 2, 3]))
    refused("2 agents after those of 3", remembering.act, images_of([1, 2]))


def test_an_exported_policy_answers_as_the_navigator_does(tmp_path, capfd):
    pytest.importorskip("onnxscript")
    runtime = pytest.importorskip("onnxruntime")
    world = rooms(("grid", "other"))
    policy, looks = trained(tmp_path, world)
    refused(r"scene=...; choose from \['grid', 'other'\]", load, tmp_path, world)
    navigator = load(tmp_path, world, scene="other")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        export_onnx(navigator, tmp_path / "policy.onnx")
    assert capfd.readouterr() == ("", "")
    (tmp_path / "moved").mkdir()
    session = runtime.InferenceSession((tmp_path / "policy.onnx").rename(tmp_path / "moved" / "policy.onnx"))
    assert [(i.name, i.shape[1:]) for i in session.get_inputs()] == [("features", [4, 16]), ("goal_features", [4, 16])]
    labels = session.get_modelmeta().custom_metadata_map
    assert (labels["scene"], labels["extractor"], labels["threshold"]) == ("other", "random", "0.9")
    assert len(labels["views"].split(",")) == 4
    for agents in (1, 2, 24):
        states, goal_index = torch.arange(24, 24 + agents), torch.full((agents,), 2)
        seen, wanted = looks.reset_view_ids(states), looks.reset_view_ids(world.goals[goal_index])
        features = {"features": world.features[seen].numpy(), "goal_features": world.features[wanted].numpy()}
        logits, value, matching = session.run(["logits", "value", "matching"], features)
        with torch.no_grad():
            expected = policy(observe(world, looks, states, seen, goal_index))
        np.testing.assert_allclose(logits, expected["logits"], rtol=0, atol=1e-5)
        np.testing.assert_allclose(value, expected["state_value"], rtol=0, atol=1e-5)
        scores = TemplateStop().scores(world)
        np.testing.assert_allclose(matching, world.block(scores, 2)[:agents], rtol=0, atol=1e-5)


def test_a_navigator_and_its_episode_can_be_pickled():
    navigator = Navigator.load("general")
    images = np.random.default_rng(0).integers(0, 256, (3, 4, 60, 80, 3), np.uint8)
    navigator.reset(images[0])
    navigator.act(images[1])
    other = pickle.loads(pickle.dumps(navigator))
    here, there = navigator.act(images[2]), other.act(images[2])
    assert (here.action, here.stop) == (there.action, there.stop)
    assert torch.equal(here.scores.probabilities, there.scores.probabilities)


@pytest.mark.parametrize(
    ("options", "width"),
    [({}, 64), ({"turns": 8}, 80), ({"recogniser": "ncc", "episodic_memory": "planning"}, 80)],
    ids=["cameras", "panoramas", "views return"],
)
def test_sharp_views_are_reduced_to_those_of_the_training(options, width):
    navigator = Navigator.load("general", **options)
    encode, widths = navigator.encoder, []
    navigator.encoder = lambda images: (widths.append(images.shape[2]), encode(images))[1]
    images = np.random.default_rng(0).integers(0, 256, (4, 60, 80, 3), np.uint8)
    navigator.reset(images[0])
    navigator.act(images)
    assert widths == [width, width]
    assert ("64 pixels across" in navigator.facts["extractor"]) == (width == 64)
