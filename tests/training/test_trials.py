"""What does not keep its contract is refused in one line before a training, and what does is trained with as it is."""

import sys
from types import SimpleNamespace

import pytest
import torch
from commands import room_file, train_config
from tensordict import TensorDict

from dirl.config.saved import config_text, read_config
from dirl.config.schemas import ConfigError
from dirl.envs import NavigationEnv
from dirl.evaluation.experts import ShortestPathExpert
from dirl.models import ActorCritic
from dirl.training.job import build_components

SMALL = ["encoder.width=32", "heads.width=32", "evaluation.times=0", "reinforcement.agents_per_scene=32"]


class Own(torch.nn.Module):
    """A loss, made of what its subclass computes."""

    in_keys = ("hidden",)

    def __init__(self, policy):
        super().__init__()


class Nothing(Own):
    def forward(self, batch):
        return TensorDict({"reported": batch["hidden"].mean()})


class Each(Own):
    def forward(self, batch):
        return TensorDict({"loss_own": batch["hidden"].mean(-1)})


class Rewards(Own):
    def reward(self, rollout):
        return rollout["hidden"].mean(-1)

    def forward(self, batch):
        return TensorDict({"loss_own": batch["hidden"].mean()})


class Headless(torch.nn.Module):
    def __init__(self, in_features):
        super().__init__()
        self.trunk = self.policy = self.value = NoScenes()


class NoScenes(torch.nn.Module):
    def forward(self, rows, scene):
        return rows[:, :3]


class Mute(ActorCritic):
    def forward(self, tensordict):
        return super().forward(tensordict).exclude("logits")


class Fifth(ShortestPathExpert):
    def __init__(self, world):
        super().__init__(world)

    def forward(self, tensordict):
        return tensordict.set("expert_action", torch.full((len(tensordict),), 4))


def components_with(tmp_path, monkeypatch, group, made):
    """What the recipe makes of a configuration with a class of this file."""
    monkeypatch.setitem(sys.modules, "own", sys.modules[__name__])
    config = train_config(f"scene={room_file(tmp_path)}", *SMALL)
    options = {"_target_": f"own.{made.__name__}"}
    setattr(config, group, {**config.losses, "own": options} if group == "losses" else options)
    return build_components(SimpleNamespace(config=config, saved=None, folder="run"))


@pytest.mark.parametrize(
    ("group", "made", "told"),
    [
        ("losses", Nothing, r"losses\.own: Nothing writes no loss_\* entry"),
        ("losses", Each, r"losses\.own: .*gives loss_own \[2\]; expected one number, \[\]"),
        ("losses", Rewards, r"losses\.own: reward\(\) gives \[2, 1\]; expected \[2, 1, 1\]"),
        ("heads", Headless, r"heads: .*, on rows \[1, 32\]: policy gives \[1, 3\] for one row; expected \[1, 4\]"),
        ("policy", Mute, r'policy: .*, on view ids \[1, 4\]: KeyError: key "logits" .*'),
        ("expert", Fifth, "expert: .*gives actions from 4 to 4; expected -1 to 3"),
    ],
)
def test_what_does_not_keep_its_contract_is_refused_before_the_training(tmp_path, monkeypatch, group, made, told):
    with pytest.raises(ConfigError, match=f"^{told}$") as raised:
        components_with(tmp_path, monkeypatch, group, made)
    assert "\n" not in str(raised.value)


class Counts(Own):
    """A loss that draws and remembers, on demonstrations whatever its argument is called."""

    in_keys = ("hidden", "expert_action")

    def __init__(self, policy):
        super().__init__(policy)
        self.calls = 0

    def forward(self, demonstrations):
        self.calls += len(torch.rand(1))
        assert "expert_action" in demonstrations
        return TensorDict({"loss_own": demonstrations["hidden"].mean()})


def test_a_trial_of_losses_leaves_no_trace(tmp_path, monkeypatch):
    torch.manual_seed(5)
    made = components_with(tmp_path, monkeypatch, "losses", Counts)
    drawn = torch.rand(3)
    torch.manual_seed(5)
    config = train_config(f"scene={room_file(tmp_path)}", *SMALL)
    plain = build_components(SimpleNamespace(config=config, saved=None, folder="run"))
    assert torch.equal(drawn, torch.rand(3))
    assert made.state.losses.losses["own"].module.calls == 0
    for one, other in zip(made.policy.parameters(), plain.policy.parameters(), strict=True):
        assert torch.equal(one, other)
    for key, value in made.state.agents.items():
        assert torch.equal(value, plain.state.agents[key]), key
    assert torch.equal(*(each.state.env.base_env.generator.get_state() for each in (made, plain)))


class Windy(NavigationEnv):
    """An environment with an option of its own, and without those of dirl's."""

    def __init__(self, world, num_agents, wind: float):
        super().__init__(world, num_agents)


def test_an_environment_of_ones_own_needs_no_option_of_dirls(monkeypatch):
    monkeypatch.setitem(sys.modules, "own", sys.modules[__name__])
    monkeypatch.setattr(Windy, "__module__", "own")
    own = {"env": {"_target_": "own.Windy", "wind": 0.1}}
    assert read_config(config_text(train_config()), "run", own, trust=["own"]).env == own["env"]
