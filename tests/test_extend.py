"""The components of docs/howto/extend.md, extend_more.md and simulators.md do what they should."""

import io
import re
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from commands import ROOT, room_file, train_config
from parts import Loop, make_parts, train_state
from refusals import refused
from tensordict.nn import TensorDictModuleBase
from torchrl.data import Unbounded
from torchrl.envs import TensorDictPrimer
from train import learn

from dirl.envs import SurroundingViews
from dirl.evaluation.episodes import shortest_episodes
from dirl.evaluation.protocol import metrics, report
from dirl.models import caching
from dirl.perception.backbones import load_encoder
from dirl.perception.recognition.recogniser import VisitScores, build_recogniser
from dirl.reporting.tables import result_table
from dirl.scenes import SceneError, load_scenes, make_world
from dirl.scenes.live import Pose
from dirl.sources.gym import GymSimulator
from dirl.sources.simulators import take_scene
from dirl.training.build import build_world
from dirl.training.objectives import ImitationLoss, demonstration_batches
from dirl.training.rollout import collect

PAGES = ("extend.md", "extend_more.md", "simulators.md")
PAGE = "".join((ROOT / "docs" / "howto" / name).read_text() for name in PAGES)
FILES = dict(re.findall(r"^```\{code-block\} python\n:caption: (\S+)\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE))
SMALL = ["encoder.width=32", "heads.width=32", "evaluation.times=0", "reinforcement.agents_per_scene=32"]
SAC = ["network.cache=off", "objective=none", "imitation.fraction=0", "reinforcement.n_steps=1"]
SAC += ["++losses.sac={_target_:discrete_sac.DiscreteSAC,width:32,batch_size:128,capacity:2000}"]
GAIL = ["imitation.bc_coef=0", "++losses.gail={_target_:gail.GAILLoss,width:32}", "imitation.fraction=1"]
INVERSE = ["++losses.inverse={_target_:inverse_dynamics.InverseDynamicsLoss,width:32,weight:1.0}"]
STACKED = ["observation._target_=stacked.StackedViews", "++observation.steps=4"]
SOME = ["observation._target_=narrow.SomeViews", "++observation.shown=[1,3]"]
WINDOW = ["memory._target_=window.WindowMemory", "++memory.steps=3"]


@pytest.fixture(scope="module", autouse=True)
def page_modules(tmp_path_factory):
    """The page's Python files can be imported."""
    folder = tmp_path_factory.mktemp("page")
    for name, text in FILES.items():
        (folder / name).write_text(text)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        yield
    for name in FILES:
        sys.modules.pop(name.removesuffix(".py"), None)


@pytest.fixture
def parts(tmp_path):
    """Parts and state of a training in a room of 24 states, with given options."""
    room = room_file(tmp_path)

    def make(*options, saved=None):
        made = make_parts(f"scene={room}", *SMALL, *options)
        return made, train_state(made, saved)

    return make


def train(state, total, until=None):
    """Train until there are so many frames; what the updates told."""
    loop = Loop(state, total, lambda state: until is not None and state.frames >= until)
    learn(state, loop)
    return loop.told


def clone(policy, demos, steps=150):
    """Learn all that the expert shows."""
    loss, optimiser = ImitationLoss(policy.operator().get_policy_head()), torch.optim.Adam(policy.parameters(), 3e-3)
    trunk, draw = policy.trunk(), demonstration_batches(policy, demos, None)
    for _ in range(steps):
        optimiser.zero_grad()
        loss(trunk(draw().copy()))["loss_imitation"].backward()
        optimiser.step()


@pytest.mark.parametrize("views", [[STACKED[0], "++observation.steps=2"], SOME], ids=["stacked", "some"])
def test_an_observation_of_ones_own_is_learnt_from_and_cached_to_the_same_result(parts, views):
    answers, ids = [], None
    for cache in ("auto", "off"):
        made, state = parts(*views, "imitation.fraction=1", "network.axes=features", f"network.cache={cache}")
        assert (state.policy.cached is not None) == (cache == "auto")
        clone(state.policy, made.demos, 3)
        train(state, total=400)
        ids = ids if ids is not None else collect(state.env, state.policy.operator(), state.agents, 9)[0]
        answers.append(state.policy(ids.select(*state.policy.in_keys).clone())["logits"])
        with caching(state.policy, learns=False):
            answers.append(state.policy(ids.select(*state.policy.in_keys).clone())["logits"])
    for answer in answers[1:]:
        torch.testing.assert_close(answer, answers[0], atol=1e-4, rtol=1e-4)
    clone(state.policy, made.demos)
    assert metrics(made.protocol.run(state.policy))["sr"] > 0.5


class Broken(SurroundingViews):
    """Fewer views than `order` names."""

    def reset_view_ids(self, picture):
        return super().reset_view_ids(picture)[..., :3]


class Forgetful(SurroundingViews):
    """A history that does not say so."""

    def step_view_ids(self, view_ids, picture):
        return torch.cat([view_ids[..., 1:], picture.unsqueeze(-1)], -1)


def test_a_window_holds_the_last_steps_of_an_episode_and_no_other(parts):
    _, state = parts(*WINDOW, "reinforcement.max_steps=5")
    batch, _ = collect(state.env, state.policy.operator(), state.agents, 12)
    seen, done = batch["next", "seen"], batch["next", "done"].squeeze(-1)
    assert (seen[:, 0] == 1).all()
    assert torch.equal(seen[:, 1:], torch.where(done[:, :-1], 1, seen[:, :-1] + 1))
    assert not batch["next", "window"][seen == 1][:, :2].any()
    assert batch["next", "window"][seen == 2][:, 1].any(-1).all()


class Stateless(TensorDictModuleBase):
    """A memory whose states are zeros, and begin with another number."""

    def __init__(self, in_key, out_key, states: list[str], start: float = 0.0):
        super().__init__()
        self.in_keys, self.out_keys = [in_key, *states, "is_init"], [out_key, *(("next", key) for key in states)]
        self.states, self.start = states, start

    def make_tensordict_primer(self):
        return TensorDictPrimer({key: Unbounded((3,)) for key in self.states}, default_value=self.start)

    def forward(self, tensordict):
        tensordict["memory"] = tensordict["fused"]
        for key in self.states:
            tensordict["next", key] = torch.zeros(*tensordict.shape, 3)
        return tensordict


STATELESS = "memory._target_=house.Stateless"


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (
            ["observation._target_=house.Broken"],
            r"observation: Broken: reset_view_ids gives \[24, 3\] for 24 pictures; order names 4 views$",
        ),
        (
            ["observation._target_=house.Forgetful"],
            "observation: Forgetful: step_view_ids gives other views than reset_view_ids, so set history = True$",
        ),
        ([STATELESS, "++memory.states=[]"], "memory.*: .*writes no recurrent state"),
        ([STATELESS, "++memory.states=[a]", "++memory.start=1.0"], "memory.*: .*state must begin with zeros"),
        (
            [*GAIL, "imitation.fraction=0"],
            r"losses\.gail: GAILLoss reads demonstrations; use imitation.fraction above 0",
        ),
        ([*INVERSE, "reinforcement.workers=2"], r"losses\.inverse: .* has weights of its own.*use one worker"),
    ],
)
def test_a_component_that_does_not_keep_its_contract_is_refused(parts, monkeypatch, options, told):
    monkeypatch.setitem(sys.modules, "house", sys.modules[__name__])
    refused(f"^{told}", parts, *options)


def test_discrete_sac_learns_from_nothing(parts):
    made, state = parts(*SAC)
    assert metrics(made.protocol.run(state.policy))["spl"] < 0.4
    train(state, total=8_000)
    assert metrics(made.protocol.run(state.policy))["spl"] > 0.6


def test_a_discriminator_gives_the_reward_before_advantages_are_computed(parts):
    made, state = parts(*GAIL, "reinforcement.n_steps=5", "optimiser.lr=3e-3")
    before = metrics(made.protocol.run(state.policy))
    batch, _ = collect(state.env, state.policy.operator(), state.agents, 5)
    rewarded = state.losses.rewarded(batch.clone())
    assert (rewarded["next", "reward"] < 0).all()
    assert rewarded["next", "reward"].shape == batch["next", "reward"].shape
    assert "hidden" not in rewarded.keys()  # noqa: SIM118, of a TensorDict
    told = train(state, total=40_000)
    assert {"loss_gail", "gail_accuracy"} <= told[0].keys()
    assert metrics(made.protocol.run(state.policy))["spl"] > 4 * before["spl"]


def test_a_training_goes_on_bit_for_bit_with_what_its_losses_hold(parts):
    _, straight = parts(*SAC)
    train(straight, total=1_000)

    _, first = parts(*SAC)
    train(first, total=1_000, until=500)
    file = io.BytesIO()
    torch.save(first.state_dict(), file)
    file.seek(0)
    torch.manual_seed(99)
    _, second = parts(*SAC, saved=torch.load(file, weights_only=True))
    assert second.frames == first.frames < 700
    train(second, total=1_000)

    assert second.frames == straight.frames
    for name, value in straight.losses.named_parameters():
        assert torch.equal(second.losses.get_parameter(name), value), name
    for one, other in zip(straight.policy.parameters(), second.policy.parameters(), strict=True):
        assert torch.equal(one, other)
    kept, again = (state.losses.losses["sac"].module.buffer for state in (straight, second))
    assert len(kept) == len(again) > 500
    assert torch.equal(kept[:]["view_ids"], again[:]["view_ids"])


HALLS = ["source._target_=halls.Halls", "++source.width=16"]


def test_scenes_come_from_a_source_of_ones_own(tmp_path):
    world = build_world(train_config("scene=[hall_4x3,hall_2x2]", *HALLS))
    assert world.names == ("hall_4x3", "hall_2x2")
    assert [len(scene) for scene in world.scenes] == [48, 16]
    assert world.features.shape == (64, 16)
    assert world.scenes[0].source == "halls"
    mixed = build_world(train_config(f"scene=[{room_file(tmp_path)}]", *HALLS))  # a file needs no source
    assert len(mixed.scenes[0]) == 24


class Returns:
    """A source that returns, or raises, what it was given."""

    def __init__(self, answer):
        self.answer = answer

    def load(self, names):
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        (["a"], r"Returns\.load\(\['x'\]\) must return a list of dirl\.scenes\.Scene, not one with str"),
        (KeyError("x"), r"source: Returns\.load\(\['x'\]\) failed \(KeyError: 'x'\)"),
        (SceneError("x: no such hall"), "^x: no such hall$"),
    ],
)
def test_a_source_that_does_not_do_what_it_should_is_refused_in_one_line(answer, says):
    refused(says, load_scenes, "x", source=Returns(answer))


def test_a_recogniser_of_ones_own_stops_agents_and_is_refused_in_one_line_if_it_is_none(tmp_path, monkeypatch):
    from cosine import Cosine

    class Broken(Cosine):
        """As `Cosine`, until members of it are replaced."""

    def made(**members):
        for name, value in members.items():
            monkeypatch.setattr(Broken, name, value)
        return VisitScores(build_recogniser({"_target_": "cosine.Cosine"}), world)

    world = make_world(load_scenes(str(room_file(tmp_path))))
    every = torch.arange(len(world))
    assert (made()(every, every) > 0.999).all()
    monkeypatch.setattr("cosine.Cosine", Broken)
    refused(r"thresholds must be Thresholds of dirl or None, not float$", made, thresholds=0.9)
    few = r"^recogniser: .*scores gave \[2\] for 2 visits and 3 references"
    refused(few, made, thresholds=None, scores=lambda self, seen, references: seen[:, 0, 0])
    flat = r"^recogniser: .*describe gave \[24\] for 24 views; expected \[N, F\]"
    refused(flat, made, describe=lambda self, features, patches=None: features[:, 0])
    monkeypatch.delattr(Cosine, "calibrated")
    refused("^recogniser: Broken has no calibrated$", made)


def test_a_metric_of_ones_own_is_measured_by_scene_and_goal(parts):
    from detours import Detours

    made, _ = parts()
    shortest = shortest_episodes(made.world, made.protocol.starts)
    summary = report(replace(shortest, steps=3 * shortest.shortest), made.world, Detours())
    assert summary["detours"] == 1.0
    assert all(goal["detours"] == 1.0 for goal in summary["scenes"]["grid"]["goals"].values())
    assert "detours" in result_table({"greedy": summary}).splitlines()[0]
    for wrong, told in ((lambda _: 3, "expected numbers by name"), (lambda _: {"sr": 1.0}, "a name of its own")):
        refused(f"^metric: .*{told}", report, shortest, made.world, wrong)


def test_an_image_encoder_of_ones_own_encodes_and_a_wrong_one_is_one_line(tmp_path):
    (tmp_path / "mine.yaml").write_text("_target_: tiles.Tiles\ntiles: 2\n")
    encoder = load_encoder(str(tmp_path / "mine.yaml"))
    views = torch.zeros(3, 20, 30, 3, dtype=torch.uint8)
    assert (encoder.extractor, encoder(views).shape) == ("mean colour of 2x2 tiles", (3, 12))
    (tmp_path / "mine.yaml").write_text("_target_: cosine.Cosine\n")
    refused(r"mine.yaml: Cosine has no text extractor, or cannot be called$", load_encoder, str(tmp_path / "mine.yaml"))


def test_an_environment_with_only_reset_and_step_is_walked_to_every_place(monkeypatch):
    import tiny_room

    simulator = GymSimulator("tiny_room.TinyRoom", left=0, right=1, ahead=2)
    scene, views = take_scene(simulator, source="simulator", step=1.0, turn=90)
    assert len(scene) == len(views) == 36
    assert (scene.graph[:, 0] >= 0).sum() == (scene.graph[:, 3] >= 0).sum() == 24
    refused(r"TinyRoom: has only reset and step, so it cannot be put at 0.3, 0 m", simulator.place, Pose(0.3, 0.0, 0.0))
    fresh = GymSimulator("tiny_room.TinyRoom", left=0, right=1, ahead=2)
    fresh.place(Pose(2.0, 1.0, 180.0))  # where it has not been yet
    assert fresh.pose == (2.0, 1.0, 180.0)
    refused("cannot be put at 3, 0 m", fresh.place, Pose(3.0, 0.0, 0.0))
    monkeypatch.setattr(tiny_room.TinyRoom, "seen", lambda self: np.zeros((4, 5)))
    told = r"TinyRoom: its observation gave float64 \[4, 5\]; expected RGB, uint8"
    refused(told, GymSimulator, "tiny_room.TinyRoom", left=0, right=1, ahead=2)


def test_views_of_a_source_may_be_an_array():
    from halls import Halls

    (scene,) = Halls().load(["hall_2x2"])
    assert scene.views[3].shape == (48, 64, 3)
    refused(r"views\[0\] gave float64 .*; expected", replace, scene, views=scene.views / 255)
