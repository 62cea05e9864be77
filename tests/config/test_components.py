"""Components by ``_target_``: every mistake is one line before anything is made."""

import sys
from functools import partial
from typing import Annotated, Literal

import pytest
from annotated_types import Interval
from commands import train_config
from refusals import refused
from torch import nn

from dirl.config.components import check_components, components, find_class, make, packages_to_trust, schedules
from dirl.config.folders import CONF
from dirl.config.schemas import Schedule


class Mine(nn.Module):
    """A component of a user's own."""

    def __init__(
        self,
        num_features: int,
        depth: Annotated[int, Interval(ge=1, le=8)],
        kind: Literal["mean", "max"] = "mean",
        plain=None,
    ) -> None:
        super().__init__()
        self.options = (num_features, depth, kind, plain)


class Deeper(Mine):
    """Hands everything on to its base."""

    def __init__(self, *, layers: int = 2, **kwargs) -> None:
        super().__init__(**kwargs)
        self.layers = layers


@pytest.fixture(autouse=True)
def package(monkeypatch):
    """This module as a package of the user's."""
    monkeypatch.setitem(sys.modules, "house", sys.modules[__name__])
    for made in (Mine, Deeper):
        monkeypatch.setattr(made, "__module__", "house")


refusal = partial(refused, ".")


@pytest.mark.parametrize("target", ["house.Mine", "house.Deeper"])
def test_a_class_is_made_of_its_options_and_of_what_it_is_offered(target):
    options = {"_target_": target, "depth": 8, "kind": "max", "plain": "anything"}
    assert make("encoder", options, num_features=7, world=object()).options == (7, 8, "max", "anything")


def test_only_what_a_training_can_do_without_may_be_null():
    assert make("memory", {"_target_": None}) is None
    config = train_config()
    config.source["_target_"] = None
    assert refusal(components, config).startswith("source._target_=null: a training needs one")


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"dept": 3}, "there is no option 'encoder.dept'; did you mean encoder.depth?"),
        ({"num_features": 3}, "there is no option 'encoder.num_features'; choose from depth, kind, plain"),
        ({"depth": None}, "encoder.depth=null: must be a valid integer"),
        ({"depth": 0}, "encoder.depth=0: must be greater than or equal to 1"),
        ({"plain": {"_target_": "os.system"}}, "encoder.plain: a component cannot hold another one"),
    ],
    ids=str,
)
def test_an_option_that_does_not_fit_is_refused(options, told):
    assert refusal(make, "encoder", {"_target_": "house.Mine", "depth": 2, **options}, num_features=7).startswith(told)


def test_a_missing_option_and_what_a_constructor_refuses_are_one_line():
    told = refusal(make, "encoder", {"_target_": "house.Mine"}, num_features=7)
    assert told == "encoder.depth: Mine needs it; give encoder.depth=..."
    heads = {"_target_": "dirl.models.ActorCriticHeads"}
    told = refusal(make, "heads", heads, scenes=["a.b", "a_b"], in_features=2, num_actions=4)
    assert told.startswith("heads: ActorCriticHeads refuses its options: the scenes' names must differ")


@pytest.mark.parametrize(
    ("group", "target", "told"),
    [
        ("encoder", "Mine", "must be the full name of a class"),
        ("encoder", "nobody.Knows", "there is no such class (No module named 'nobody'); is its folder on PYTHONPATH?"),
        ("encoder", "os.system", "is no class"),
        ("encoder", "torch.optim.Adam", "must be a subclass of torch.nn.modules.module.Module"),
        ("observation", "torchrl.envs.transforms.StepCounter", "must be a subclass of dirl.envs.transforms.Surrou"),
        ("source", "dirl.runs.folder.Run", "has no method load, which every source has"),
    ],
)
def test_what_is_no_class_of_a_component_is_refused(group, target, told):
    message = refusal(find_class, group, target)
    assert message.startswith(f"{group}._target_={target}: ")
    assert told in message


def test_a_class_that_a_trusted_package_only_imports_is_refused():
    told = refusal(find_class, "encoder", "dirl.models.policy.nn.Linear", ())
    assert told.startswith("encoder._target_=dirl.models.policy.nn.Linear: ")
    told = refusal(find_class, "encoder", "dirl.envs.navigation.EnvBase", ())
    assert "is not defined in 'dirl' but in 'torchrl" in told


def test_every_component_of_a_configuration_is_found():
    config = train_config("objective=ppo")
    assert set(components(config)) == {
        "observation", "encoder", "heads", "policy", "recogniser", "expert", "losses.imitation", "losses.ppo",
        "optimiser", "source", "env",
    }  # fmt: skip
    check_components(config, ())
    config.encoder = {"width": 3}
    assert refusal(components, config).startswith("encoder: names no class")
    config = train_config()
    config.losses["a2c"]["gama"] = 1
    assert refusal(check_components, config).startswith("there is no option 'losses.a2c.gama'")


@pytest.mark.parametrize("system", sorted(file.stem for file in (CONF / "system").glob("*.yaml")))
def test_every_system_gives_its_components_options_that_they_have(system):
    check_components(train_config(f"system={system}"), ())


def test_schedules_are_weights_and_what_has_a_start_and_an_end():
    options = {"_target_": "x.Y", "weight": 2, "coef": {"start": 1, "end": 0}, "other": 3}
    assert schedules("losses.mine", options) == {"weight": Schedule(2.0, 2.0), "coef": Schedule(1.0, 0.0)}
    assert schedules("losses.mine", {"_target_": "x.Y"}) == {"weight": Schedule(1.0, 1.0)}
    assert "losses.mine.weight=" in refusal(schedules, "losses.mine", {"weight": float("inf")})


def test_the_packages_that_a_configuration_needs_trusted_are_named():
    config = train_config()
    assert packages_to_trust(config) == []
    config.encoder = {"_target_": "mine.deep.Encoder"}
    config.losses["gail"] = {"_target_": "theirs.GAIL"}
    config.optimiser = {"_target_": "torch.optim.Adam"}
    assert packages_to_trust(config) == ["mine", "theirs"]
