"""The swaps of docs/howto/extend.md, made from the files on that page, do what they should."""

import io
import re
import sys
from types import SimpleNamespace

import pytest
import torch
from commands import ROOT, room_file, train_config
from parts import Loop
from tensordict import TensorDict
from train import learn

from dirl.config.schemas import ConfigError
from dirl.evaluation.experts import ShortestPathExpert
from dirl.evaluation.protocol import metrics
from dirl.models import ActorCritic, ActorCriticHeads, FeatureTable
from dirl.models.fast.caching import CachedEncoder
from dirl.objectives import ImitationLoss
from dirl.scenes import SceneError, load_scenes
from dirl.training.build import (
    build_demonstrations,
    build_losses,
    build_observation,
    build_protocol,
    build_world,
    trained_parameters,
)
from dirl.training.job import begin
from dirl.training.load import learning_policy
from dirl.training.losses import ScheduledLoss
from dirl.training.rollout import collect

PAGE = (ROOT / "docs" / "howto" / "extend.md").read_text()
FILES = dict(re.findall(r"^```\{code-block\} python\n:caption: (\S+)\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE))
SMALL = ["encoder.width=32", "heads.width=32", "evaluation.times=0", "reinforcement.agents_per_scene=32"]
SAC = ["network.cache=off", "objective=none", "losses=[]", "imitation.fraction=0", "reinforcement.n_steps=1"]
SAC += ["++losses.sac={_target_:discrete_sac.DiscreteSAC,width:32,batch_size:128,capacity:2000}"]
GAIL = ["losses=[]", "++losses.gail={_target_:gail.GAILLoss,width:32}", "imitation.fraction=1"]
INVERSE = ["++losses.inverse={_target_:inverse_dynamics.InverseDynamicsLoss,width:32,weight:1.0}"]


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
    """Configuration, protocol and state of a training in a room of 24 states, with given options."""
    room = room_file(tmp_path)

    def make(*options, saved=None):
        config = train_config(f"scene={room}", *SMALL, *options)
        world = build_world(config)
        observation = build_observation(config, world)
        torch.manual_seed(config.seed)
        policy = learning_policy(config, world, observation)
        losses = build_losses(config, policy, world, build_demonstrations(config, world, observation))
        protocol = build_protocol(config, world, observation)
        return (
            config,
            protocol,
            begin(SimpleNamespace(config=config, saved=saved, folder="run"), policy, losses, protocol),
        )

    return make


def train(config, state, total, until=None):
    """Train until there are so many frames; what the updates told."""
    loop = Loop(state, total, lambda state: until is not None and state.frames >= until)
    learn(config, state, loop)
    return loop.told


def test_each_swap_takes_one_python_file_and_one_yaml_file_at_most():
    assert sorted(FILES) == [
        "attention.py",
        "discrete_sac.py",
        "gail.py",
        "halls.py",
        "inverse_dynamics.py",
        "noisy.py",
    ]
    yaml = re.findall(r"^:caption: (\S+\.yaml)$", PAGE, re.MULTILINE)
    assert len(yaml) == len(set(yaml)) == 7


@pytest.fixture
def attention():
    from attention import AttentionEncoder

    torch.manual_seed(0)
    return AttentionEncoder(num_features=6, width=16, heads=2)


def test_attention_knows_views_by_their_direction_not_their_order(attention):
    views, order = torch.randn(5, 4, 6), [2, 0, 3, 1]
    before = attention.embed(views)
    assert not torch.allclose(attention.embed(views[:, order]), before, atol=1e-3)
    with torch.no_grad():
        attention.direction.copy_(attention.direction[order])
    torch.testing.assert_close(attention.embed(views[:, order]), before)


def test_attention_is_cached_to_the_same_result(attention):
    table = FeatureTable(torch.randn(9, 6))
    heads = ActorCriticHeads(["room"], 16, 4)
    policy = ActorCritic(table, attention, heads)
    policy.cache(None)
    assert type(policy.cached) is CachedEncoder
    ids, goal_ids = torch.randint(9, (2, 20, 4))
    torch.testing.assert_close(policy.cached(ids, goal_ids), attention(table(ids), table(goal_ids)))


def test_attention_learns_what_the_expert_shows(parts):
    config, protocol, state = parts("encoder._target_=attention.AttentionEncoder", "imitation.fraction=1")
    policy, rows = state.policy, build_demonstrations(config, protocol.world, protocol.observation)
    trunk, loss = policy.trunk(), ImitationLoss(policy.operator().get_policy_head())
    optimiser = torch.optim.Adam(policy.parameters(), 3e-3)
    assert metrics(protocol.run(policy))["sr"] < 0.5
    for _ in range(200):
        optimiser.zero_grad()
        loss(trunk(rows.copy()))["loss_imitation"].backward()
        optimiser.step()
    assert metrics(protocol.run(policy))["spl"] == 1


def test_discrete_sac_learns_from_nothing(parts):
    config, protocol, state = parts(*SAC)
    before = metrics(protocol.run(state.policy))
    train(config, state, total=8_000)
    after, random = metrics(protocol.run(state.policy)), metrics(protocol.run_random())
    assert before["spl"] < 0.4
    assert random["spl"] < 0.4
    assert after["spl"] > 0.7


def test_a_noisy_expert_shows_other_actions_as_often_as_it_should(parts):
    from noisy import NoisyExpert

    _, protocol, _ = parts()
    goal_index, state = (each.repeat(100) for each in protocol.world.pairs())
    rows = TensorDict({"state": state, "goal": protocol.world.goals[goal_index]}, batch_size=[len(state)])

    def shown(expert):
        return expert(rows.clone())["expert_action"]

    best = shown(ShortestPathExpert(protocol.world))
    noisy = shown(NoisyExpert(protocol.world, seed=1, noise=0.3))
    advises = best >= 0
    assert (noisy[~advises] == -1).all()
    assert set(noisy[advises].tolist()) == {0, 1, 2, 3}
    assert (noisy != best)[advises].float().mean().item() == pytest.approx(0.3, abs=0.03)
    assert torch.equal(noisy, shown(NoisyExpert(protocol.world, seed=1, noise=0.3)))
    assert not torch.equal(noisy, shown(NoisyExpert(protocol.world, seed=2, noise=0.3)))
    assert torch.equal(best, shown(NoisyExpert(protocol.world, seed=1, noise=0.0)))


def test_inverse_dynamics_is_learnt(parts):
    config, _, state = parts(*INVERSE, "imitation.fraction=0", "reinforcement.n_steps=1", "optimiser.lr=5e-3")
    told = train(config, state, total=12_000)
    assert told[0]["inverse_accuracy"] < 0.5
    assert sum(values["inverse_accuracy"] for values in told[-20:]) / 20 > 0.7


def test_a_discriminator_gives_the_reward_before_advantages_are_computed(parts):
    config, protocol, state = parts(*GAIL, "reinforcement.n_steps=5", "optimiser.lr=3e-3")
    before = metrics(protocol.run(state.policy))
    batch, _ = collect(state.env, state.policy.operator(), state.agents, 5)
    rewarded = state.losses.rewarded(batch.clone())
    assert (rewarded["next", "reward"] < 0).all()
    assert rewarded["next", "reward"].shape == batch["next", "reward"].shape
    assert "hidden" not in rewarded.keys()  # noqa: SIM118, of a TensorDict
    told = train(config, state, total=40_000)
    assert {"loss_gail", "gail_accuracy"} <= told[0].keys()
    assert metrics(protocol.run(state.policy))["spl"] > 4 * before["spl"]


def test_a_loss_that_compares_needs_demonstrations(parts):
    with pytest.raises(
        ConfigError, match=r"^losses\.gail: GAILLoss reads demonstrations; use imitation.fraction above 0"
    ):
        parts(*GAIL, "imitation.fraction=0")


@pytest.mark.parametrize("options", [SAC, [*INVERSE, "memory=gru", "memory.hidden_size=16"]], ids=["sac", "gru"])
def test_a_training_goes_on_bit_for_bit_with_what_its_losses_hold(parts, options):
    config, _, straight = parts(*options)
    train(config, straight, total=2_000)

    config, _, first = parts(*options)
    train(config, first, total=2_000, until=1_000)
    file = io.BytesIO()
    torch.save(first.state_dict(), file)
    file.seek(0)
    torch.manual_seed(99)
    config, _, second = parts(*options, saved=torch.load(file, weights_only=True))
    assert second.frames == first.frames < 1_200
    train(config, second, total=2_000)

    assert second.frames == straight.frames
    for name, value in straight.losses.named_parameters():
        assert torch.equal(second.losses.get_parameter(name), value), name
    for one, other in zip(straight.policy.parameters(), second.policy.parameters(), strict=True):
        assert torch.equal(one, other)
    if options is SAC:
        kept, again = (state.losses.losses["sac"].module.buffer for state in (straight, second))
        assert len(kept) == len(again) > 1_000
        assert torch.equal(kept[:]["view_ids"], again[:]["view_ids"])


def test_a_checkpoint_does_not_hold_the_policy_twice(parts):
    _, _, state = parts(*SAC)
    held = [name for name in state.state_dict()["losses"] if "actor_network" in name or name.startswith("trunk")]
    assert held == []


def test_the_seed_alone_decides_the_weights_of_a_loss(parts):
    def head(seed):
        config, protocol, state = parts(*INVERSE)
        torch.manual_seed(seed)
        demos = build_demonstrations(config, protocol.world, protocol.observation)
        made = build_losses(config, state.policy, protocol.world, demos)
        return made.losses["inverse"].module.head[0].weight

    assert torch.equal(head(1), head(2))


def test_a_loss_with_weights_of_its_own_is_refused_by_several_workers(parts):
    with pytest.raises(ConfigError, match=r"losses\.inverse: .* has weights of its own.*use one worker"):
        parts(*INVERSE, "reinforcement.workers=2")


def test_a_loss_must_say_what_it_reads(parts):
    with pytest.raises(ConfigError, match=r"losses\.bare: ReLU has no in_keys"):
        parts("++losses.bare={_target_:torch.nn.ReLU}")


class Nothing(torch.nn.Module):
    in_keys = ("hidden",)

    def forward(self, batch):
        return TensorDict({"reported": batch["hidden"].mean()})


def test_a_loss_must_write_one(parts):
    config, _, state = parts()
    schedules = state.losses.losses["a2c"].schedules
    state.losses.losses["nothing"] = ScheduledLoss(Nothing(), schedules)
    with pytest.raises(ConfigError, match=r"losses\.nothing: Nothing writes no loss_"):
        train(config, state, total=100)


def test_heads_take_any_batch_dimensions_and_vmap():
    torch.manual_seed(0)
    heads = ActorCriticHeads(["bath", "bed", "kitchen"], 5, 4, width=7)
    rows, scene = torch.randn(6, 8, 5), torch.randint(3, (6, 8))

    def logits(rows, scene):
        return heads.policy(heads.trunk(rows, scene), scene)

    each = torch.stack([logits(some, of) for some, of in zip(rows, scene, strict=True)])
    torch.testing.assert_close(logits(rows, scene), each)
    torch.testing.assert_close(torch.vmap(logits)(rows, scene), each)


def test_own_parameters_are_trained_with_the_policys(parts):
    _, _, state = parts(*SAC)
    own = len(trained_parameters(state.policy, state.losses)) - len(trained_parameters(state.policy))
    assert own == len(list(state.losses.losses["sac"].module.loss.qvalue_network_params.parameters())) == 6


HALLS = ["source._target_=halls.Halls", "++source.width=16"]


def test_scenes_come_from_a_source_of_ones_own(tmp_path):
    world = build_world(train_config("scene=[hall_4x3,hall_2x2]", *HALLS))
    assert world.names == ("hall_4x3", "hall_2x2")
    assert [len(scene) for scene in world.scenes] == [48, 16]
    assert world.features.shape == (64, 16)
    assert world.source == "halls"
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
        ([], r"must return a list of dirl\.scenes\.Scene, not one without any"),
        (None, r"source: Returns\.load\(\['x'\]\) failed \(TypeError: "),
        (KeyError("x"), r"source: Returns\.load\(\['x'\]\) failed \(KeyError: 'x'\)"),
        (SceneError("x: no such hall"), "^x: no such hall$"),
    ],
)
def test_a_source_that_does_not_do_what_it_should_is_refused_in_one_line(answer, says):
    with pytest.raises(SceneError, match=says) as caught:
        load_scenes("x", source=Returns(answer))
    assert "\n" not in str(caught.value)


def test_a_source_without_the_method_is_refused():
    with pytest.raises(SceneError, match=r"^source: Pure\w*Path has no method load\(names\)"):
        build_world(train_config("scene=x", "source._target_=pathlib.PurePath"))
