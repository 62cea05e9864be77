import copy
import subprocess
import sys
import warnings

import numpy as np
import pytest
import torch
from commands import train_config
from rooms import grid_scene

import dirl
from dirl import Navigator
from dirl.backbones import ResNet50
from dirl.deploy.navigator import NavigatorError
from dirl.deploy.onnx import export_onnx
from dirl.envs import OBSERVATIONS
from dirl.evaluation import every_start, trajectories
from dirl.models import feature_statistics, make_network
from dirl.runs.folder import Run, load_checkpoint, save_checkpoint
from dirl.scenes import make_world
from dirl.scenes.matching import TemplateStop

PIXELS = (2, 5)
"""Height and width of the images, which differ so that neither passes for the other."""


def images_of(states):
    """Images of states, uint8 ``[..., H, W, 3]``: every pixel of one is its state's number."""
    states = np.asarray(states, np.uint8)
    return np.broadcast_to(states[..., None, None, None], (*states.shape, *PIXELS, 3))


def look_up(world):
    """An encoder that knows the features of every image of `images_of`."""
    return lambda images: world.features[images[:, 0, 0, 0].long()]


def rooms(names=("grid",), width=16):
    """Rooms of 24 states; two are alike in everything but their features."""
    return make_world(
        [grid_scene(name=name, goals=(0, 13), seed=seed, feature_width=width) for seed, name in enumerate(names)]
    )


def trained(folder, world, *options):
    """The folder of a finished run with a network that walks some way, and that network."""
    config = train_config("network.width=24", *options)
    folder.mkdir(exist_ok=True)
    run = Run(folder, config)
    run.begin(world)
    network = make_network(
        world.features,
        world.names,
        statistics=feature_statistics(world.features),
        heads=config.network.heads,
        width=24,
        seed=1,
    )
    with torch.no_grad():  # untrained logits hardly differ; what is sampled shall
        for layer in network.policy.scenes.values():
            layer.weight.mul_(20)
    run.finish({"frames": 7, "network": network.state_dict()}, {})
    return network


def load(folder, world, **options):
    return Navigator.load(folder, look_up(world), extractor="random", **options)


@pytest.mark.parametrize("heads", ["scene", "shared"])
@pytest.mark.parametrize("match", ["views", "front"])
@pytest.mark.parametrize("observation", ["surrounding", "sequential"])
def test_a_navigator_walks_and_stops_as_the_evaluation_does(tmp_path, observation, match, heads):
    world = rooms(("grid", "other.room"))
    network = trained(tmp_path, world, f"observation={observation}", f"stop.match={match}", f"network.heads={heads}")
    sight = OBSERVATIONS[observation](world)
    if observation == "sequential":
        match = "front"  # a single camera cannot compare four views
    threshold = 0.1  # low enough for false stops among random features
    stop = TemplateStop(threshold, match)(world)
    starts = every_start(world)
    episodes, paths = trajectories(network, world, starts, sight=sight, stop=stop, max_steps=12)
    assert episodes.success.any()
    assert episodes.false_stop.any()
    assert not (episodes.success | episodes.false_stop).all()
    see = (lambda state: images_of(world.surrounding[state])) if observation == "surrounding" else images_of
    for index, name in enumerate(world.names):
        navigator = load(tmp_path, world, scene=name)
        navigator.threshold = threshold
        for episode in torch.nonzero(world.scene_of[starts[1]] == index).flatten().tolist():
            goal, state = world.goals[starts[0][episode]], starts[1][episode]
            navigator.reset(see(goal))
            action, stopped, _ = navigator.act(see(state))
            walked = [int(state)]
            while len(walked) <= 12 and (len(walked) == 1 or not stopped):
                state = world.graph[state, action]
                walked.append(int(state))
                action, stopped, _ = navigator.act(see(state))
            assert walked == paths[episode]
            assert stopped == bool(stop[starts[0][episode], state])


@pytest.fixture
def world():
    return rooms()


@pytest.fixture
def run(tmp_path, world):
    """The folder of a run with surrounding views."""
    trained(tmp_path / "run", world)
    return tmp_path / "run"


@pytest.fixture
def navigator(run, world):
    return load(run, world)


def test_the_checkpoint_alone_decides_threshold_and_scores(run, world, navigator):
    goal, state = 0, 9
    navigator.reset(images_of(world.surrounding[goal]))
    decision = navigator.act(images_of(world.surrounding[state]))
    network = trained(run.parent / "again", world)
    logits, _ = network(world.surrounding[[state]], world.surrounding[[goal]], torch.zeros(1, dtype=torch.long))
    torch.testing.assert_close(decision.scores.probabilities, logits[0].softmax(-1))
    assert decision.scores.matching == pytest.approx(TemplateStop().scores(world)[0, state].item(), abs=1e-5)
    assert navigator.threshold == 0.9
    assert navigator.act(images_of(world.surrounding[goal])).stop is True


@pytest.mark.parametrize("observation", ["surrounding", "sequential"])
def test_a_batch_decides_as_each_alone_and_torch_as_numpy(tmp_path, observation):
    world = rooms()
    trained(tmp_path, world, f"observation={observation}")
    sight = OBSERVATIONS[observation](world)
    see = (lambda states: images_of(sight.begin(states))) if observation == "surrounding" else images_of
    batch, alone = load(tmp_path, world), load(tmp_path, world)
    goals, walks = torch.tensor([0, 13, 0]), torch.tensor([[5, 6, 7, 8], [14, 13, 12, 1], [2, 1, 0, 3]])
    batch.reset(torch.from_numpy(see(goals).copy()))
    together = [batch.act(torch.from_numpy(see(walks[:, time]).copy())) for time in range(4)]
    for agent in range(3):
        alone.reset(see(goals[agent]))
        for time, both in enumerate(together):
            action, stop, scores = alone.act(see(walks[agent, time]))
            assert (type(action), type(stop), type(scores.matching)) == (int, bool, float)
            assert (action, stop) == (both.action[agent].item(), both.stop[agent].item())
            assert scores.matching == pytest.approx(both.scores.matching[agent].item(), abs=1e-6)
            torch.testing.assert_close(scores.probabilities, both.scores.probabilities[agent])
    assert together[1].stop.tolist() == [False, True, False]


def test_one_goal_serves_a_batch_of_agents(world, navigator):
    navigator.reset(images_of(world.surrounding[13]))
    assert navigator.act(images_of(world.surrounding[[13, 4]])).stop.tolist() == [True, False]


def test_a_reset_forgets_the_views_before_it(tmp_path, world):
    trained(tmp_path, world, "observation=sequential")
    navigator = load(tmp_path, world)
    navigator.reset(images_of(0))
    first = navigator.act(images_of(9)).scores.probabilities
    later = navigator.act(images_of(10)).scores.probabilities
    navigator.reset(images_of(0))
    torch.testing.assert_close(navigator.act(images_of(9)).scores.probabilities, first, rtol=0, atol=0)
    assert not torch.allclose(navigator.act(images_of(9)).scores.probabilities, later)


def test_sampled_actions_come_as_often_as_their_probability_says(world, navigator):
    navigator.reset(images_of(world.surrounding[0]))
    images = images_of(world.surrounding[[9] * 2000])
    draws = [navigator.act(images, sample=True, generator=torch.Generator().manual_seed(5)) for _ in range(2)]
    assert torch.equal(draws[0].action, draws[1].action)
    shares = torch.bincount(draws[0].action, minlength=4) / 2000
    torch.testing.assert_close(shares, draws[0].scores.probabilities[0], rtol=0, atol=0.04)
    assert (shares > 0.05).sum() > 1


def test_images_may_be_flipped_or_read_only_views_of_others(world, navigator):
    images = images_of(world.surrounding[9])
    navigator.reset(images_of(world.surrounding[0]))
    assert not images.flags.writeable
    assert navigator.act(images[..., ::-1])[:2] == navigator.act(images.copy())[:2]


def test_another_extractor_is_refused(run, world):
    with pytest.raises(NavigatorError, match="another extractor: 'random', not 'CLIP'"):
        Navigator.load(run, look_up(world), extractor="CLIP")
    with pytest.raises(NavigatorError, match=r"say which extractor .* trained with 'random'"):
        Navigator.load(run, look_up(world))
    with pytest.raises(NavigatorError, match="another extractor"):
        Navigator.load(run, "resnet50.pth", extractor="CLIP")


def test_an_encoder_of_another_width_is_refused(run, world):
    navigator = load(run, rooms(width=17))
    with pytest.raises(NavigatorError, match=r"gave torch.float32 \[4, 17\] for 4 images; .*\[4, 16\]: random"):
        navigator.reset(images_of(world.surrounding[0]))


def test_features_that_are_no_numbers_are_refused(run, world):
    nan = Navigator.load(run, lambda images: torch.full((len(images), 16), torch.nan), extractor="random")
    with pytest.raises(NavigatorError, match="not finite"):
        nan.reset(images_of(world.surrounding[0]))
    whole = Navigator.load(run, lambda images: np.zeros((len(images), 16), int), extractor="random")
    with pytest.raises(NavigatorError, match="int64"):
        whole.reset(images_of(world.surrounding[0]))


def test_weights_of_a_resnet_are_an_encoder_and_warn_where_nobody_said_what_they_are(tmp_path):
    world = rooms(width=2048)
    trained(tmp_path, world)
    with torch.random.fork_rng():
        torch.manual_seed(0)
        torch.save(ResNet50().state_dict(), tmp_path / "resnet.pth")
    with pytest.warns(UserWarning, match="resnet.pth .* 'random'"):
        Navigator.load(tmp_path, tmp_path / "resnet.pth")
    navigator = Navigator.load(tmp_path, tmp_path / "resnet.pth", extractor="random")
    goal = np.random.default_rng(0).integers(0, 256, (4, 40, 50, 3), np.uint8)
    navigator.reset(goal)
    assert navigator.act(goal).scores.matching == pytest.approx(1, abs=1e-5)


def test_the_scene_must_be_one_of_the_checkpoint(tmp_path):
    world = rooms(("grid", "other"))
    trained(tmp_path / "own", world)
    trained(tmp_path / "shared", world, "network.heads=shared")
    with pytest.raises(NavigatorError, match=r"scene=...; choose from \['grid', 'other'\]"):
        load(tmp_path / "own", world)
    with pytest.raises(NavigatorError, match=r"not trained in 'grod'; choose from \['grid', 'other'\]"):
        load(tmp_path / "shared", world, scene="grod")
    load(tmp_path / "shared", world)  # shared layers need no scene


@pytest.mark.parametrize(
    "shape", [(2, 5, 3), (3, 2, 5, 3), (4, 2, 5), (4, 2, 5, 4), (1, 1, 4, 2, 5, 3), (0, 4, 2, 5, 3)]
)
def test_images_of_another_shape_are_refused(navigator, shape):
    with pytest.raises(NavigatorError, match=r"goal_images: expected uint8 \[4, H, W, 3\] .*, found torch.uint8"):
        navigator.reset(np.zeros(shape, np.uint8))


@pytest.mark.parametrize("shape", [(5, 3), (2, 5, 4), (1, 4, 2, 5, 3)])
def test_sequential_views_come_one_at_a_time(tmp_path, world, shape):
    trained(tmp_path, world, "observation=sequential")
    with pytest.raises(NavigatorError, match=r"expected uint8 \[H, W, 3\] or \[B, H, W, 3\]"):
        load(tmp_path, world).reset(np.zeros(shape, np.uint8))


def test_images_that_are_no_bytes_or_no_array_are_refused(world, navigator):
    images = images_of(world.surrounding[0])
    with pytest.raises(NavigatorError, match="float32"):
        navigator.reset(images / np.float32(255))
    with pytest.raises(NavigatorError, match="found list"):
        navigator.reset(list(images))


def test_agents_and_goals_must_be_as_many(tmp_path, world, navigator):
    with pytest.raises(NavigatorError, match="call reset"):
        navigator.act(images_of(world.surrounding[0]))
    navigator.reset(images_of(world.surrounding[[0, 13]]))
    with pytest.raises(NavigatorError, match="3 agents for 2 goals"):
        navigator.act(images_of(world.surrounding[[1, 2, 3]]))
    trained(tmp_path / "sequential", world, "observation=sequential")
    remembering = load(tmp_path / "sequential", world)
    remembering.reset(images_of(0))
    remembering.act(images_of([1, 2, 3]))
    with pytest.raises(NavigatorError, match="2 agents after those of 3"):
        remembering.act(images_of([1, 2]))


def spoilt(run, **changes):
    state = copy.deepcopy(load_checkpoint(run)) | changes
    save_checkpoint(run / "network.pt", {key: value for key, value in state.items() if value is not None})


def test_checkpoints_name_the_order_of_their_views_and_another_order_is_refused(run, world):
    assert load_checkpoint(run)["views"] == ["ahead", "right", "back", "left"]
    spoilt(run, views=None)
    load(run, world)  # written before the order was
    spoilt(run, views=["ahead", "left", "back", "right"])
    with pytest.raises(NavigatorError, match="trained on the views"):
        load(run, world)


def test_weights_of_another_network_are_refused(run, world):
    weights = load_checkpoint(run)["network"]
    spoilt(run, network={**weights, "encoder.fusion.bias": torch.zeros(3)})
    with pytest.raises(NavigatorError, match="do not fit"):
        load(run, world)
    spoilt(run, network={})
    with pytest.raises(NavigatorError, match="do not fit"):
        load(run, world)


def test_a_device_that_is_not_there_is_refused(run, world):
    if torch.cuda.is_available():
        pytest.skip("there is one")
    with pytest.raises(NavigatorError, match="no CUDA device"):
        load(run, world, device="cuda")


def test_importing_the_package_does_not_import_torch():
    code = "import sys, dirl; assert 'torch' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
    with pytest.raises(AttributeError, match="'dirl' has no attribute 'Nagivator'"):
        _ = dirl.Nagivator


@pytest.mark.parametrize(
    ("observation", "match"), [("surrounding", "views"), ("surrounding", "front"), ("sequential", "views")]
)
def test_an_exported_policy_answers_as_the_navigator_does(tmp_path, observation, match, capfd):
    pytest.importorskip("onnxscript")
    runtime = pytest.importorskip("onnxruntime")
    world = rooms(("grid", "other"))
    network = trained(tmp_path, world, f"observation={observation}", f"stop.match={match}")
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
    sight = OBSERVATIONS[observation](world)
    for agents in (1, 2, 24):
        seen, wanted = sight.begin(torch.arange(24, 24 + agents)), sight.begin(torch.full((agents,), 24))
        features = {"features": world.features[seen].numpy(), "goal_features": world.features[wanted].numpy()}
        logits, value, matching = session.run(["logits", "value", "matching"], features)
        with torch.no_grad():
            expected, expected_value = network(seen, wanted, torch.ones(agents, dtype=torch.long))
        np.testing.assert_allclose(logits, expected, rtol=0, atol=1e-5)
        np.testing.assert_allclose(value, expected_value, rtol=0, atol=1e-5)
        front = match == "front" or observation == "sequential"
        scores = TemplateStop(match="front" if front else "views").scores(world)[2, 24 : 24 + agents]
        np.testing.assert_allclose(matching, scores, rtol=0, atol=1e-5)


def test_without_its_packages_the_export_says_what_to_install(navigator, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxscript", None)
    with pytest.raises(NavigatorError, match=r"pip install 'dirl\[onnx\]'"):
        export_onnx(navigator, tmp_path / "policy.onnx")
