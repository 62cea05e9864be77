"""Components by ``_target_``: every mistake is one line before anything is made."""

import sys
from typing import Annotated, Literal

import pytest
import torch
from commands import train_config
from torch import nn

from dirl.config.bounds import Bounds
from dirl.config.components import (
    check_components,
    class_parameters,
    components,
    find_class,
    make,
    packages_to_trust,
    schedules,
)
from dirl.config.schemas import ConfigError, Schedule
from dirl.models import SiameseEncoder


class Mine(nn.Module):
    """A component of a user's own."""

    def __init__(
        self,
        num_features: int,
        depth: Annotated[int, Bounds(1, 8)],
        rate: Annotated[float, Bounds(0)] = 0.5,
        kind: Literal["mean", "max"] = "mean",
        name: str | None = None,
        gated: bool = False,
    ) -> None:
        super().__init__()
        self.options = (num_features, depth, rate, kind, name, gated)


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


def refusal(call, *arguments, **options):
    with pytest.raises(ConfigError) as raised:
        call(*arguments, **options)
    assert "\n" not in str(raised.value)
    return str(raised.value)


def encoder(**options):
    return {"_target_": "house.Mine", "depth": 2, **options}


@pytest.mark.parametrize("target", ["house.Mine", "house.Deeper"])
def test_a_class_is_made_of_its_options_and_of_what_it_is_offered(target):
    made = make("encoder", encoder(_target_=target, rate=1, kind="max"), num_features=7, world=object())
    assert made.options == (7, 2, 1, "max", None, False)


def test_a_parameter_without_annotation_takes_anything(monkeypatch):
    class Plain(nn.Module):
        def __init__(self, width):
            super().__init__()
            self.width = width

    monkeypatch.setattr(Plain, "__module__", "house")
    monkeypatch.setattr(sys.modules["house"], "Plain", Plain, raising=False)
    assert [make("encoder", {"_target_": "house.Plain", "width": value}).width for value in (3, "x")] == [3, "x"]


def test_nothing_is_made_where_no_class_is_named():
    assert make("memory", {"_target_": None}) is None


@pytest.mark.parametrize("group", ["policy", "observation", "optimiser", "env", "recogniser", "source"])
def test_what_every_training_has_cannot_be_null(group):
    config = train_config()
    getattr(config, group)["_target_"] = None
    assert refusal(components, config).startswith(f"{group}._target_=null: a training needs one")


@pytest.mark.parametrize(("group", "method"), [("source", "load"), ("simulator", "place")])
def test_a_class_without_the_methods_of_its_group_is_refused(group, method):
    told = refusal(find_class, group, "dirl.runs.folder.Run", ())
    assert told == f"{group}._target_=dirl.runs.folder.Run: has no method {method}, which every {group} has"


def test_options_handed_on_are_those_of_the_base():
    assert list(class_parameters(Deeper)) == ["num_features", "depth", "rate", "kind", "name", "gated", "layers"]
    assert set(class_parameters(SiameseEncoder)) == {"num_features", "num_views", "width"}


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"dept": 3}, "there is no option 'encoder.dept'; did you mean encoder.depth?"),
        ({"xyz": 3}, "there is no option 'encoder.xyz'; choose from depth, rate, kind, name, gated"),
        ({"num_features": 3}, "there is no option 'encoder.num_features'; choose from"),
        ({"depth": 1.5}, "encoder.depth=1.5: must be a valid integer"),
        ({"depth": True}, "encoder.depth=True: must be a valid integer"),
        ({"depth": None}, "encoder.depth=null: must be a valid integer"),
        ({"depth": 0}, "encoder.depth=0: must be greater than or equal to 1"),
        ({"depth": 9}, "encoder.depth=9: must be less than or equal to 8"),
        ({"rate": -0.1}, "encoder.rate=-0.1: must be greater than or equal to 0"),
        ({"rate": "fast"}, "encoder.rate=fast: must be a valid number"),
        ({"rate": float("nan")}, "encoder.rate=nan: must be a finite number"),
        ({"rate": float("inf")}, "encoder.rate=inf: must be a finite number"),
        ({"kind": "median"}, "encoder.kind=median: must be 'mean' or 'max'"),
        ({"name": 3}, "encoder.name=3: must be a valid string"),
        ({"gated": 1}, "encoder.gated=1: must be a valid boolean"),
        ({"name": {"_target_": "os.system"}}, "encoder.name: a component cannot hold another one"),
    ],
    ids=str,
)
def test_an_option_that_does_not_fit_is_refused(options, told):
    assert refusal(make, "encoder", encoder(**options), num_features=7).startswith(told)


def test_a_missing_option_is_named():
    told = refusal(make, "encoder", {"_target_": "house.Mine"}, num_features=7)
    assert told == "encoder.depth: Mine needs it; give encoder.depth=..."


@pytest.mark.parametrize(
    ("target", "told"),
    [
        ("Mine", "must be the full name of a class"),
        (3, "must be the full name of a class"),
        ("house.mine-2", "must be the full name of a class"),
        ("nobody.Knows", "there is no such class (No module named 'nobody'); is its folder on PYTHONPATH?"),
        ("house.Mien", "there is no such class"),
        ("house.refusal", "is no class"),
        ("os.system", "is no class"),
        ("builtins.eval", "is no class"),
        ("pathlib.Path", "must be a subclass of torch.nn.modules.module.Module"),
        ("torch.optim.Adam", "must be a subclass of torch.nn.modules.module.Module"),
    ],
)
def test_what_is_no_class_of_a_component_is_refused(target, told):
    message = refusal(find_class, "encoder", target)
    assert message.startswith(f"encoder._target_={target}: ")
    assert told in message


def test_an_optimiser_is_no_module():
    assert find_class("optimiser", "torch.optim.Adam") is torch.optim.Adam
    assert "must be a subclass of torch.optim" in refusal(find_class, "optimiser", "torch.nn.Linear")


@pytest.mark.parametrize(
    "target", ["os.system", "builtins.eval", "torch.load", "pathlib.Path", "torch.nn.Linear", "house.Mine"]
)
def test_a_configuration_from_a_file_names_dirls_classes_only(target):
    package = target.split(".")[0]
    told = refusal(find_class, "encoder", target, ())
    assert told.endswith(f"names a class of '{package}'; trust=[{package}] allows it")


def test_what_is_not_trusted_is_not_even_imported(monkeypatch):
    monkeypatch.delitem(sys.modules, "this", raising=False)
    refusal(find_class, "encoder", "this.Zen", ("house",))
    assert "this" not in sys.modules


def test_trust_allows_a_package():
    assert find_class("encoder", "house.Mine", ("house",)) is Mine
    assert find_class("encoder", "dirl.models.SiameseEncoder", ()) is SiameseEncoder
    assert find_class("memory", "torchrl.modules.GRUModule", ()).__name__ == "GRUModule"


def test_a_class_that_a_trusted_package_only_imports_is_refused():
    told = refusal(find_class, "encoder", "dirl.models.policy.nn.Linear", ())
    assert told.startswith("encoder._target_=dirl.models.policy.nn.Linear: ")
    told = refusal(find_class, "encoder", "dirl.envs.navigation.EnvBase", ())
    assert "is not defined in 'dirl' but in 'torchrl" in told


def test_what_a_constructor_refuses_is_one_line():
    heads = {"_target_": "dirl.models.ActorCriticHeads"}
    told = refusal(make, "heads", heads, scenes=["a.b", "a_b"], in_features=2, num_actions=4)
    assert told.startswith("heads: ActorCriticHeads refuses its options: the scenes' names must differ")


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


@pytest.mark.parametrize("choice", [["memory=gru"], ["heads=shared"], ["observation=sequential"], ["preset=paper"]])
def test_every_choice_of_dirls_own_fits_its_constructor(choice):
    check_components(train_config(*choice), ())


def test_schedules_are_weights_and_what_has_a_start_and_an_end():
    options = {"_target_": "x.Y", "weight": 2, "coef": {"start": 1, "end": 0}, "other": 3}
    assert schedules("losses.mine", options) == {"weight": Schedule(2.0, 2.0), "coef": Schedule(1.0, 0.0)}
    assert schedules("losses.mine", {"_target_": "x.Y"}) == {"weight": Schedule(1.0, 1.0)}
    for wrong in ("much", float("inf"), None):
        assert "losses.mine.weight=" in refusal(schedules, "losses.mine", {"weight": wrong})


def test_the_packages_that_a_configuration_needs_trusted_are_named():
    config = train_config()
    assert packages_to_trust(config) == []
    config.encoder = {"_target_": "mine.deep.Encoder"}
    config.losses["gail"] = {"_target_": "theirs.GAIL"}
    config.optimiser = {"_target_": "torch.optim.Adam"}
    assert packages_to_trust(config) == ["mine", "theirs"]


def test_a_transform_that_cannot_say_what_is_seen_of_a_state_is_refused():
    says = refusal(find_class, "observation", "torchrl.envs.transforms.StepCounter")
    assert "must be a subclass of dirl.envs.transforms.SurroundingViews" in says
